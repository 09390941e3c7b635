/* Arduino Nano, ATmega328P at 16 MHz: servos on D9 to D11 (PB1 to PB3), force sensor on A0, host on USART0. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include "../core/limits.h"

/* clock.c: milliseconds and servo pulses from Timer1, in ticks of 0.5 us. */
void clock_start(const uint16_t pulses[SERVOS]);
uint32_t clock_ms(void);
bool clock_ms_is_due(void); /* true from each new millisecond until it is handled */
void clock_ms_is_served(void);
bool servo_frame_is_due(void); /* true from 1 ms before the first pulse of a frame until its pulses are set */
void servo_set(const uint16_t pulses[SERVOS]);

/* sensor.c: mean of all conversions since the last call, in 1/64 count. */
void sensor_start(void);
uint16_t sensor_mean(void);

/* line.c: USART0, 8N1. */
void line_start(void);
bool line_take(uint8_t *byte);
bool line_is_empty(void);
void line_send(const uint8_t *bytes, uint8_t length); /* all bytes, or none if they do not fit */
uint8_t line_overruns(void);

/* reset.c: cause and number of resets. */
uint8_t reset_cause(void);
uint16_t reset_count(void); /* includes this one; call once */

#endif
