/* The vector table of a Cortex-M for the emulator; newlib's _start does the rest. */
#include <stdint.h>

extern void _start(void);

__attribute__((section(".vectors"), used)) static const uintptr_t vectors[] = {0x20080000, (uintptr_t)_start};
