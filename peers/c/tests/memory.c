/* Memory for few positions, announced contact and codecs that follow the hand: what is refused; and nodes that their
 * program uses although they were refused. Built with sanitizers. */
#include <stdio.h>
#include <stdlib.h>

#include "hapticnet.h"

static uint32_t random32(void *context)
{
    (void)context;
    return 7;
}

static int failures;

static void check(bool good, const char *what)
{
    if (good)
        return;
    printf("wrong: %s\n", what);
    failures++;
}

static hn_request request_of(const char *codec)
{
    return (hn_request){.codec = codec, .name = "a", .weber_fraction = 0.05, .floor_n = 0.025, .multiplier = 1.0,
                        .rate_hz = 1000.0, .axes = 1};
}

static bool is_taken(const hn_request *request)
{
    static hn_master master;
    return hn_master_init(&master, request, random32, NULL) == NULL;
}

/* As the README has it. */
static void *give(hn_request *request)
{
    void *memory = malloc(hn_more_bytes(request));
    request->more = hn_more_init(memory, request);
    return memory;
}

/* A master for seven axes, and a slave for four, of a program that reads no error. */
static void use_refused(void)
{
    static hn_master master;
    static hn_slave slave;
    hn_request request = request_of("raw");
    double position_m[7] = {0.0}, force_n[7] = {1.0, 1.0, 1.0};
    uint8_t data[HN_DATAGRAM_BYTES], answer[HN_DATAGRAM_BYTES];
    request.axes = 7;
    check(hn_master_init(&master, &request, random32, NULL) != NULL, "seven axes");
    hn_master_tick(&master, position_m, 1000);
    hn_master_force(&master, force_n, 1000);
    check(hn_master_send(&master, data) == 0 && hn_master_state(&master) == HN_CLOSED, "a refused master asks");
    check(force_n[0] == 0.0 && force_n[1] == 0.0 && force_n[2] == 0.0, "a refused master has a force");

    request.axes = 3;
    check(hn_master_init(&master, &request, random32, NULL) == NULL, "three axes");
    hn_master_close(&master, NULL, 0);
    check(hn_master_state(&master) == HN_CLOSED, "a master closes without a reason");
    hn_master_init(&master, &request, random32, NULL);
    check(hn_slave_init(&slave, "scene", 4, random32, NULL) != NULL, "four axes");
    for (int64_t now_us = 0; now_us < 100000; now_us += 1000) {
        hn_master_tick(&master, position_m, now_us);
        for (size_t size; (size = hn_master_send(&master, data)) > 0;) {
            size = hn_slave_receive(&slave, data, size, "here", 4, now_us, answer);
            hn_master_receive(&master, answer, size, now_us);
        }
        check(!hn_slave_position(&slave, position_m), "a refused slave has a position");
    }
    check(hn_master_state(&master) == HN_CLOSED, "a refused slave grants a session");
    check(hn_slave_close(&slave, NULL, 0, answer) == 0, "a refused slave has a session");
}

int main(void)
{
    hn_request plain = request_of("deadband"), wrong = plain, few = plain, follows = request_of("motion-predictive");
    void *memory[4] = {give(&plain)};
    check(plain.more == NULL && is_taken(&plain), "a request that needs no memory");

    wrong.position_share = 0.25;
    wrong.rate_hz = 1e9;
    memory[1] = give(&wrong);
    check(wrong.more == NULL && !is_taken(&wrong), "a rate out of range");

    few.position_share = 0.25;
    check(hn_more_init(NULL, &few) == NULL, "no memory");
    memory[2] = give(&few);
    check(few.more != NULL && is_taken(&few), "few positions");
    few.announced = true;
    check(!is_taken(&few), "announced contact that was asked for later");
    few.announced = false;
    few.axes = 2;
    check(!is_taken(&few), "an axis more than the memory is for");

    memory[3] = give(&follows);
    check(is_taken(&follows), "a codec that follows the hand");
    follows.rate_hz = 2000.0;
    check(!is_taken(&follows), "a rate higher than the memory is for");
    follows.rate_hz = 1000.0;
    follows.codec = "deadband";
    check(!is_taken(&follows), "another codec");

    follows.codec = "motion-predictive";
    uint8_t *crooked = malloc(hn_more_bytes(&follows) + 1);
    check(crooked != NULL && hn_more_init(crooked + 1, &follows) == NULL, "memory that is not aligned");
    free(crooked);
    for (unsigned i = 0; i < 4; i++)
        free(memory[i]);
    use_refused();
    return failures;
}
