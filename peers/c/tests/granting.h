/* A network between both ends that grants masters what this library's slave does not have: few positions, announced
 * contact, other codecs. Only the fuzzer has it; elsewhere it changes nothing, so that its code is not linked. */
#ifndef GRANTING_H
#define GRANTING_H

#include "hapticnet.h"

unsigned below(unsigned limit);

#ifdef FUZZ
void ask_for_more(hn_request *request);
size_t with_more(uint8_t *data, size_t size);    /* rewrite what the slave sends; return its size */
size_t without_more(uint8_t *data, size_t size); /* and what the master sends: the slave reads the plainest kind */
#else
#define ask_for_more(request) (void)(request)
#define with_more(data, size) (size)
#define without_more(data, size) (size)
#endif

#endif
