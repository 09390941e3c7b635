/* SPDX-License-Identifier: GPL-3.0-or-later
 *
 * Runs the firmware's ELF in simavr, in lockstep with the process on the other end of stdin and stdout.
 *
 *   harness FIRMWARE.elf
 *
 * Each request advances the time. No clock is read: the same requests give the same replies, and the requester paces
 * them to real time if needed. Numbers are little-endian, as on every supported host.
 *
 *   request  uint32 advance [cycles], uint16 voltage on A0 [0.1 mV], uint16 n, n bytes for the UART
 *   reply    struct reply, n bytes from the UART, n_edges of struct edge */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <avr_adc.h>
#include <avr_ioport.h>
#include <avr_uart.h>
#include <sim_avr.h>
#include <sim_cycle_timers.h>
#include <sim_elf.h>
#include <sim_interrupts.h>

#define CLOCK_HZ 16000000u
#define FIRST_PIN 1 /* PB1 to PB3: D9 to D11 */
#define SERVOS 3
#define VECTORS 26
#define UCSR0A 0xC0
#define UBRR0L 0xC4
#define U2X0 0x02

/* 5 V [0.1 mV] less one part in 1024, because the converter divides by 1024 (data sheet) but simavr by 1023. */
#define REFERENCE 49951

/* simavr takes 11 bit times for a byte of 10 bits; sending faster would only fill its FIFO. */
#define BITS_PER_BYTE 11

#define MOST_BYTES (1u << 20)
#define MOST_EDGES (1u << 16)

struct request {
    uint32_t advance_cycles;
    uint16_t tenth_millivolts;
    uint16_t bytes;
};

struct reply {
    uint64_t cycle;
    uint32_t bytes;
    uint32_t edges;
    uint32_t resets;         /* since the start, without power-on */
    uint32_t latency_cycles; /* longest time that any interrupt was pending since the start */
};

struct edge {
    uint64_t cycle;
    uint32_t servo;
    uint32_t level;
};

static avr_t *avr;
static avr_irq_t *uart_input, *pins[SERVOS], *adc0;
static void (*mcu_reset)(avr_t *);
static uint32_t resets, latency_cycles;
static avr_cycle_count_t pending_since[VECTORS], next_byte_at;

static uint8_t from_uart[MOST_BYTES];
static uint32_t n_from_uart;
static uint8_t to_uart[MOST_BYTES]; /* ring buffer */
static uint32_t to_head, to_tail;
static struct edge edges[MOST_EDGES];
static uint32_t n_edges;

static void die(const char *what)
{
    fprintf(stderr, "harness: %s\n", what);
    exit(2);
}

static void on_uart_output(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq, (void)param;
    if (n_from_uart < MOST_BYTES)
        from_uart[n_from_uart++] = (uint8_t)value;
}

static void on_pin(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq;
    if (n_edges < MOST_EDGES)
        edges[n_edges++] = (struct edge){avr->cycle, (uint32_t)(uintptr_t)param, value};
}

static void on_pending(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq;
    if (value)
        pending_since[(uintptr_t)param] = avr->cycle;
}

static void on_running(avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq;
    uint32_t waited = (uint32_t)(avr->cycle - pending_since[(uintptr_t)param]);
    if (value && waited > latency_cycles)
        latency_cycles = waited;
}

/* A reset turns the pins into inputs, which simavr does not report. */
static void on_reset(avr_t *which)
{
    mcu_reset(which);
    resets++;
    for (int i = 0; i < SERVOS; i++)
        avr_raise_irq(pins[i], 0);
}

/* Time is counted in cycles; the host's clock is not used. */
static void on_sleep(avr_t *which, avr_cycle_count_t cycles)
{
    (void)which, (void)cycles;
}

static void quiet(avr_t *which, const int level, const char *format, va_list arguments)
{
    (void)which;
    if (level == LOG_ERROR)
        vfprintf(stderr, format, arguments);
}

static avr_cycle_count_t cycles_per_byte(void)
{
    uint32_t divisor = (avr->data[UBRR0L] | (avr->data[UBRR0L + 1] & 0x0Fu) << 8) + 1u;
    return (avr->data[UCSR0A] & U2X0 ? 8u : 16u) * divisor * BITS_PER_BYTE;
}

static void feed_uart(void)
{
    if (to_head == to_tail || avr->cycle < next_byte_at)
        return;
    next_byte_at = avr->cycle + cycles_per_byte();
    avr_raise_irq(uart_input, to_uart[to_tail]);
    to_tail = (to_tail + 1) % MOST_BYTES;
}

static avr_cycle_count_t on_stop(avr_t *which, avr_cycle_count_t when, void *param)
{
    (void)which, (void)param;
    return when + 1; /* until the next stop is set: the controller may fall asleep in this cycle */
}

/* While the controller sleeps, a run continues to the next event whatever the limit, so the stop is also an event. */
static void run_until(avr_cycle_count_t stop)
{
    static avr_cycle_count_t last_stop;
    avr_cycle_count_t left = stop > avr->cycle ? stop - avr->cycle : 1;
    if (stop != last_stop) {
        last_stop = stop;
        avr_cycle_timer_register(avr, left, on_stop, NULL);
    }
    avr->run_cycle_limit = left;
    int state = avr_run(avr);
    if (state == cpu_Done || state == cpu_Crashed)
        die("the firmware crashed");
}

static void advance(avr_cycle_count_t cycles)
{
    avr_cycle_count_t end = avr->cycle + cycles;
    while (avr->cycle < end) {
        feed_uart();
        run_until(to_head != to_tail && next_byte_at < end ? next_byte_at : end);
    }
}

static void queue_for_uart(uint8_t byte)
{
    uint32_t next = (to_head + 1) % MOST_BYTES;
    if (next == to_tail)
        die("too many bytes for the UART");
    to_uart[to_head] = byte;
    to_head = next;
}

static void start(const char *path)
{
    elf_firmware_t firmware = {0};
    avr_global_logger_set(quiet);
    if (elf_read_firmware(path, &firmware))
        die("cannot read the firmware");
    avr = avr_make_mcu_by_name("atmega328p");
    if (!avr || avr_init(avr))
        die("this simavr does not support the ATmega328P");
    firmware.frequency = CLOCK_HZ;
    firmware.vcc = firmware.avcc = firmware.aref = REFERENCE;
    avr_load_firmware(avr, &firmware);
    avr->frequency = CLOCK_HZ;
    avr->log = LOG_ERROR;
    avr->sleep = on_sleep;

    uint32_t flags = 0; /* do not print what is sent; do not sleep while it is polled */
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    uart_input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    adc0 = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_uart_output, NULL);
    for (int i = 0; i < SERVOS; i++) {
        pins[i] = avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), FIRST_PIN + i);
        avr_irq_register_notify(pins[i], on_pin, (void *)(uintptr_t)i);
    }
    for (uintptr_t vector = 1; vector < VECTORS; vector++) {
        avr_irq_t *irq = avr_get_interrupt_irq(avr, (uint8_t)vector);
        if (!irq)
            continue;
        avr_irq_register_notify(irq + AVR_INT_IRQ_PENDING, on_pending, (void *)vector);
        avr_irq_register_notify(irq + AVR_INT_IRQ_RUNNING, on_running, (void *)vector);
    }
    mcu_reset = avr->reset;
    avr->reset = on_reset;
}

static void answer(void)
{
    struct reply reply = {avr->cycle, n_from_uart, n_edges, resets, latency_cycles};
    fwrite(&reply, sizeof reply, 1, stdout);
    fwrite(from_uart, 1, n_from_uart, stdout);
    fwrite(edges, sizeof edges[0], n_edges, stdout);
    if (fflush(stdout))
        exit(0);
    n_from_uart = n_edges = 0;
}

int main(int argc, char **argv)
{
    struct request request;
    static uint8_t bytes[UINT16_MAX];
    if (argc != 2)
        die("usage: harness FIRMWARE.elf");
    start(argv[1]);
    while (fread(&request, sizeof request, 1, stdin) == 1) {
        if (fread(bytes, 1, request.bytes, stdin) != request.bytes)
            break;
        for (uint32_t i = 0; i < request.bytes; i++)
            queue_for_uart(bytes[i]);
        avr_raise_irq(adc0, request.tenth_millivolts);
        advance(request.advance_cycles);
        answer();
    }
    return 0;
}
