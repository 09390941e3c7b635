/* Included before everything else when the shared library is built with hidden symbols: what these headers declare, and
 * nothing else, is visible. */
#if !defined(_DEFAULT_SOURCE)
#define _DEFAULT_SOURCE /* for keys.c, before any header */
#endif
#if defined(__GNUC__)
#pragma GCC visibility push(default)
#endif
#include "hapticnet.h"
#include "hapticnet_binding.h"
#if defined(HN_SEALED)
#include "hapticnet_keys.h"
#endif
#if defined(__GNUC__)
#pragma GCC visibility pop
#endif
