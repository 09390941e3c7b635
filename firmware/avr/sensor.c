/* The converter runs freely on A0 at 125 kHz, within the 50 to 200 kHz required for 10 bits (ATmega328P data sheet);
 * a conversion takes 13 clocks, 104 us. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "../core/messages.h"
#include "board.h"

static volatile uint16_t sum; /* room for 64 conversions of 1023 */
static volatile uint8_t count;

void sensor_start(void)
{
    ADMUX = _BV(REFS0); /* AVcc, channel 0 */
    DIDR0 = _BV(ADC0D);
    ADCSRB = 0;
    ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADATE) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0);
}

ISR(ADC_vect)
{
    uint16_t adc = ADC;
    if (count == 64) { /* not read for 7 ms: start over */
        sum = 0;
        count = 0;
    }
    sum += adc;
    count++;
}

uint16_t sensor_mean(void)
{
    static uint16_t mean;
    uint16_t taken;
    uint8_t of;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        taken = sum;
        of = count;
        sum = 0;
        count = 0;
    }
    if (of != 0)
        mean = (uint16_t)((uint32_t)taken * ADC_FRACTION / of);
    return mean;
}
