/* Timer1 runs freely at 16 MHz / 8. Compare A makes the edges of the servo pulses, compare B the milliseconds.
 *
 * The three pulses of a frame are in separate slots, so edges never coincide. The interrupt for an edge comes
 * LEAD_TICKS early and waits for the exact time, so that other interrupts do not delay the edge. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "board.h"

#define MS_TICKS TICKS(1000)
#define SLOT_TICKS TICKS(2500) /* the longest pulse is 2020 us */
#define LEAD_TICKS TICKS(8)    /* the longest other interrupt takes 5 us */
#define FRAME_TICKS (FRAME_MS * MS_TICKS)
#define SERVO_PINS (_BV(PB1) | _BV(PB2) | _BV(PB3))

/* Events of a frame: rise and fall of each servo, then the request for the next frame's pulses. */
#define CALL (2 * SERVOS)

static volatile uint32_t now_ms;
static volatile bool ms_due, frame_due;
static volatile uint16_t pulse_ticks[SERVOS];

/* Used only by the compare A interrupt. */
static uint16_t frame_start, edge;
static uint8_t event, port;

void clock_start(const uint16_t pulses[SERVOS])
{
    DDRB |= SERVO_PINS;
    servo_set(pulses);
    event = CALL;
    edge = frame_start = MS_TICKS;
    OCR1A = edge - LEAD_TICKS;
    OCR1B = MS_TICKS + MS_TICKS / 2; /* apart from the edges */
    TIMSK1 = _BV(OCIE1A) | _BV(OCIE1B);
    TCCR1B = _BV(CS11); /* clock / 8 */
}

ISR(TIMER1_COMPB_vect)
{
    OCR1B += MS_TICKS;
    now_ms++;
    ms_due = true;
}

ISR(TIMER1_COMPA_vect)
{
    if (event == CALL) {
        frame_due = true;
        frame_start += MS_TICKS;
        edge = frame_start;
        port = _BV(PB1);
        event = 0;
    } else {
        uint16_t at = edge;
        uint8_t level = port;
        while ((int16_t)(TCNT1 - at) < 0)
            ;
        PORTB = level; /* nothing else uses this port */
        uint8_t servo = event >> 1;
        event++;
        if (event & 1) {
            edge = at + pulse_ticks[servo];
            port = 0;
        } else if (event < CALL) {
            frame_start += SLOT_TICKS;
            edge = frame_start;
            port = (uint8_t)(_BV(PB1) << (servo + 1));
        } else {
            frame_start += FRAME_TICKS - (SERVOS - 1) * SLOT_TICKS - MS_TICKS;
            edge = frame_start;
        }
    }
    OCR1A = edge - LEAD_TICKS;
}

uint32_t clock_ms(void)
{
    uint32_t ms;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { ms = now_ms; }
    return ms;
}

bool clock_ms_is_due(void)
{
    return ms_due;
}

void clock_ms_is_served(void)
{
    ms_due = false;
}

bool servo_frame_is_due(void)
{
    return frame_due;
}

void servo_set(const uint16_t pulses[SERVOS])
{
    frame_due = false; /* the next frame is 20 ms away */
    for (uint8_t i = 0; i < SERVOS; i++)
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { pulse_ticks[i] = pulses[i]; }
}
