/* The core on the host, for tests: reads one command per line and answers with one line.
 *
 *   start MS            reset; the board is a Nano
 *   receive MS HEX      bytes from the host           -> answers as hex
 *   tick MS ADC         new millisecond                 -> reading as hex
 *   frame MS            servo frame                   -> the three pulses
 *   alive MS            whether to reset the watchdog -> 0 or 1
 *   damaged             number of dropped frames, modulo 256
 *   decode HEX          body from the host            -> kind and fields
 *   encode KIND FIELD.. body from the device          -> hex of its frame */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../core/device.h"

#define LONGEST_LINE (1u << 20)

static struct device device;

static void print_hex(const uint8_t *bytes, uint8_t length)
{
    while (length--)
        printf("%02x", *bytes++);
}

/* Return the next number of the line, or 0 at its end. */
static uint32_t number(void)
{
    const char *word = strtok(NULL, " \n");
    return word ? (uint32_t)strtoul(word, NULL, 0) : 0;
}

static bool next_byte(const char **hex, uint8_t *byte)
{
    unsigned value;
    if (sscanf(*hex, "%2x", &value) != 1)
        return false;
    *byte = (uint8_t)value;
    *hex += 2;
    return true;
}

static void receive(void)
{
    uint8_t byte, out[LONGEST_FRAME + 1];
    uint32_t now_ms = number();
    const char *hex = strtok(NULL, " \n");
    while (hex && next_byte(&hex, &byte))
        print_hex(out, device_receive(&device, byte, now_ms, out));
}

static void tick(void)
{
    uint8_t out[LONGEST_FRAME + 1];
    uint32_t now_ms = number();
    print_hex(out, device_tick(&device, now_ms, (uint16_t)number(), 0, out));
}

static void servo_frame(void)
{
    safety_frame(&device.safety, number());
    for (int i = 0; i < SERVOS; i++)
        printf("%u ", device.safety.held[i]);
}

static void decode(void)
{
    uint8_t body[LONGEST_BODY], length = 0;
    struct hello hello;
    struct setpoint setpoint;
    struct stream stream;
    const char *hex = strtok(NULL, " \n");
    while (hex && length < sizeof body && next_byte(&hex, &body[length]))
        length++;
    if (get_hello(&hello, body, length))
        printf("%u %u %u", HELLO, hello.protocol_major, hello.protocol_minor);
    else if (get_setpoint(&setpoint, body, length))
        printf("%u %u %u %u %u", SETPOINT, setpoint.sequence, setpoint.pulses[0], setpoint.pulses[1],
               setpoint.pulses[2]);
    else if (get_stream(&stream, body, length))
        printf("%u %u", STREAM, stream.period_ms);
}

/* Initialisers have no fixed order of evaluation, so each field is read in its own statement. */
static uint8_t put(uint32_t kind, uint8_t *body)
{
    uint32_t f[16];
    for (int i = 0; i < 16; i++)
        f[i] = number();
    if (kind == IDENTITY) {
        struct identity m = {
            (uint8_t)f[0], (uint8_t)f[1], (uint8_t)f[2], (uint8_t)f[3], (uint8_t)f[4], (uint8_t)f[5],
            (uint16_t)f[6], f[7],
            {{(uint16_t)f[8], (uint16_t)f[9]}, {(uint16_t)f[10], (uint16_t)f[11]}, {(uint16_t)f[12], (uint16_t)f[13]}},
            (uint16_t)f[14], (uint8_t)f[15],
        };
        return put_identity(&m, body);
    }
    if (kind == READING) {
        struct reading m = {
            (uint16_t)f[0], f[1], (uint16_t)f[2], (uint16_t)f[3], (uint8_t)f[4], (uint16_t)f[5],
            (uint8_t)f[6], (uint8_t)f[7], (uint8_t)f[8],
        };
        return put_reading(&m, body);
    }
    struct stream_ack m = {(uint8_t)f[0], (uint8_t)f[1]};
    return put_stream_ack(&m, body);
}

static void encode(void)
{
    uint8_t body[LONGEST_BODY], out[LONGEST_FRAME + 1];
    uint32_t kind = number();
    print_hex(out, frame(body, put(kind, body), out));
}

int main(void)
{
    static char line[LONGEST_LINE];
    static const struct board board = {16000000u, 7, 1, 10, 1};
    device_start(&device, &board, 0);
    while (fgets(line, sizeof line, stdin)) {
        const char *verb = strtok(line, " \n");
        if (!verb)
            return 2;
        if (!strcmp(verb, "start"))
            device_start(&device, &board, number());
        else if (!strcmp(verb, "receive"))
            receive();
        else if (!strcmp(verb, "tick"))
            tick();
        else if (!strcmp(verb, "frame"))
            servo_frame();
        else if (!strcmp(verb, "alive"))
            printf("%d", safety_alive(&device.safety, number()));
        else if (!strcmp(verb, "damaged"))
            printf("%u", device.line.damaged);
        else if (!strcmp(verb, "decode"))
            decode();
        else if (!strcmp(verb, "encode"))
            encode();
        else
            return 2;
        puts("");
        fflush(stdout);
    }
    return 0;
}
