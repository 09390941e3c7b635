/* Memory for few positions, announced contact and codecs that follow the hand: what is refused. Built with sanitizers. */
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
    return failures;
}
