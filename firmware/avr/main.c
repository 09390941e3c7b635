/* Main loop: connects the core to the board and sleeps between interrupts. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#include "../core/device.h"
#include "board.h"

static struct device device;

#ifdef TEST_HANG
/* For tests of the hardware watchdog: three setpoint sequences that each cause a different hang. */
static void hang_if_told(void)
{
    switch (device.safety.applied_sequence) {
    case TEST_HANG + 2: /* only servo frames stop */
        TIMSK1 &= (uint8_t)~_BV(OCIE1A);
        break;
    case TEST_HANG + 1: /* everything stops */
        cli();
        /* fall through */
    case TEST_HANG: /* only interrupts continue */
        for (;;)
            ;
    }
}
#else
static void hang_if_told(void)
{
}
#endif

static void serve_frame(void)
{
    safety_frame(&device.safety, clock_ms());
    servo_set(device.safety.held);
    hang_if_told();
}

static void serve_millisecond(void)
{
    uint8_t out[LONGEST_FRAME + 1];
    clock_ms_is_served();
    uint32_t now_ms = clock_ms();
    line_send(out, device_tick(&device, now_ms, sensor_mean(), line_overruns(), out));
    if (safety_alive(&device.safety, now_ms))
        wdt_reset();
}

static void serve_line(void)
{
    uint8_t out[LONGEST_FRAME + 1];
    uint8_t byte;
    if (line_take(&byte))
        line_send(out, device_receive(&device, byte, clock_ms(), out));
}

/* Sleep until the next interrupt, unless there is work. */
static void sleep_until_something_is_due(void)
{
    cli();
    if (!servo_frame_is_due() && !clock_ms_is_due() && line_is_empty()) {
        sei(); /* takes effect after the next instruction, so no interrupt can come before the sleep */
        sleep_cpu();
    }
    sei();
}

int main(void)
{
    wdt_enable(WDTO_60MS); /* frees the finger within 150 ms, restart included, even if its clock is slow by half */
    struct board board = {
        .clock_hz = F_CPU,
        .reset_cause = reset_cause(),
        .boot_id = reset_count(),
        .adc_bits = 10,
        .fastest_stream_ms = 1, /* a reading is 20 bytes on the line */
    };
    device_start(&device, &board, 0);
    line_start();
    sensor_start();
    clock_start(device.safety.held);
    set_sleep_mode(SLEEP_MODE_IDLE);
    sleep_enable();
    sei();
    for (;;) {
        if (servo_frame_is_due())
            serve_frame();
        else if (clock_ms_is_due())
            serve_millisecond();
        else if (!line_is_empty())
            serve_line();
        else
            sleep_until_something_is_due();
    }
}
