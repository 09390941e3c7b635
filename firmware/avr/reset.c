/* Cause of the last reset, saved before it can be overwritten, and number of resets, in EEPROM. */
#include <avr/eeprom.h>
#include <avr/io.h>
#include <avr/wdt.h>

#include "board.h"

static uint8_t mcusr_seen __attribute__((section(".noinit")));
static uint8_t r2_seen __attribute__((section(".noinit")));
static uint16_t boots_kept EEMEM;

/* After a watchdog reset the watchdog stays on, at 16 ms, until WDRF is cleared, so clear it before main. */
void keep_reset_cause(void) __attribute__((naked, used, section(".init3")));
void keep_reset_cause(void)
{
    __asm__ volatile("sts %0, r2" : : "i"(&r2_seen));
    mcusr_seen = MCUSR;
    MCUSR = 0;
    wdt_disable();
}

/* The Optiboot bootloader clears MCUSR and passes it in r2. */
uint8_t reset_cause(void)
{
    return (mcusr_seen != 0 ? mcusr_seen : r2_seen) & (_BV(PORF) | _BV(EXTRF) | _BV(BORF) | _BV(WDRF));
}

/* Works for 100 000 resets, the EEPROM's endurance (ATmega328P data sheet). */
uint16_t reset_count(void)
{
    uint16_t count = eeprom_read_word(&boots_kept) + 1u;
    eeprom_update_word(&boots_kept, count);
    return count;
}
