/* Nodes on the heap, whose numbers have names. */
#include "hapticnet_binding.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "messages.h"
#ifdef HN_SEALED
#include "hapticnet_keys.h"

typedef char error_fits[(int)HN_ERROR_BYTES >= (int)HN_WRONG_BYTES ? 1 : -1];
#endif

typedef struct {
    hn_master master; /* first, so that a pointer to it is one to this */
    char codec[HN_NAME_BYTES + 1], name[HN_NAME_BYTES + 1];
    char parameters[HN_MOST_PARAMETERS][HN_NAME_BYTES + 1];
    void *more;
#ifdef HN_SEALED
    hn_master_keys keys;
#endif
} held_master;

typedef struct {
    hn_slave slave;
    char scene[HN_NAME_BYTES + 1];
#ifdef HN_SEALED
    hn_slave_keys keys;
    hn_listed *listed;
#endif
} held_slave;

static const char NO_MEMORY[] = "there is no memory for it";

/* Overwrite memory that is freed next, which a compiler would leave out. */
static void wipe(void *memory, size_t size)
{
    volatile uint8_t *at = memory;
    while (size-- > 0)
        *at++ = 0;
}

#ifdef HN_SEALED
static void free_listed(hn_listed *listed, size_t count)
{
    if (listed != NULL)
        wipe(listed, count * sizeof *listed);
    free(listed);
}
#endif

/* Return a copy of a text, or the text itself if it is one that the library refuses. */
static const char *copy(char to[HN_NAME_BYTES + 1], const char *text)
{
    return text == NULL || strlen(text) > HN_NAME_BYTES ? text : strcpy(to, text);
}

/* Set a number of a request by its name; return whether it has one of this name. */
static bool set(hn_request *request, const char *name, double value)
{
    const struct {
        const char *name;
        double *value;
    } numbers[] = {
        {"weber_fraction", &request->weber_fraction},
        {"floor_n", &request->floor_n},
        {"multiplier", &request->multiplier},
        {"rate_hz", &request->rate_hz},
        {"position_share", &request->position_share},
    };
    for (unsigned i = 0; i < sizeof numbers / sizeof *numbers; i++)
        if (strcmp(numbers[i].name, name) == 0) {
            *numbers[i].value = value;
            return true;
        }
    if (strcmp(name, "axes") == 0)
        request->axes = (unsigned)value;
    else if (strcmp(name, "announced") == 0)
        request->announced = value != 0.0;
    else if (strcmp(name, "predicted") == 0)
        request->predicted = value != 0.0;
    else
        return false;
    return true;
}

/* Fill a request; return false, with what is wrong, if that must be said here. */
static bool fill(held_master *held, hn_request *request, const char *const names[], const double values[],
                 size_t count, char wrong[HN_ERROR_BYTES])
{
    unsigned parameters = 0;
    for (size_t i = 0; i < count; i++) {
        if (strcmp(names[i], "axes") == 0 && !(values[i] >= 1.0 && values[i] <= HN_MOST_AXES)) {
            snprintf(wrong, HN_ERROR_BYTES, "axes is %.12g; it must be 1 to %d", values[i], HN_MOST_AXES);
            return false;
        }
        if (set(request, names[i], values[i]))
            continue;
        if (parameters < HN_MOST_PARAMETERS)
            request->parameters[parameters] = (hn_parameter){copy(held->parameters[parameters], names[i]), values[i]};
        parameters++;
    }
    if (parameters > HN_MOST_PARAMETERS) {
        snprintf(wrong, HN_ERROR_BYTES, "parameters has %u entries; a codec has at most %d", parameters,
                 HN_MOST_PARAMETERS);
        return false;
    }
    size_t more_bytes = hn_more_bytes(request);
    held->more = more_bytes > 0 ? malloc(more_bytes) : NULL;
    if (more_bytes > 0 && held->more == NULL) {
        snprintf(wrong, HN_ERROR_BYTES, "%s", NO_MEMORY);
        return false;
    }
    request->more = hn_more_init(held->more, request);
    return true;
}

static void free_held(held_master *held)
{
    if (held == NULL)
        return;
    free(held->more);
    wipe(held, sizeof *held);
    free(held);
}

hn_master *hn_make_master(const char *codec, const char *name, const char *const names[], const double values[],
                          size_t count, hn_entropy *entropy, void *context, char wrong[HN_ERROR_BYTES])
{
    hn_request request = {
        .weber_fraction = HN_DEFAULT_WEBER_FRACTION,
        .floor_n = HN_DEFAULT_FLOOR_N,
        .multiplier = HN_DEFAULT_MULTIPLIER,
        .rate_hz = HN_DEFAULT_RATE_HZ,
        .axes = 1,
    };
    held_master *held = calloc(1, sizeof *held);
    snprintf(wrong, HN_ERROR_BYTES, "%s", NO_MEMORY);
    if (held == NULL)
        return NULL;
    request.codec = copy(held->codec, codec);
    request.name = copy(held->name, name);
    bool is_filled = fill(held, &request, names, values, count, wrong);
    const char *refused = is_filled ? hn_master_init(&held->master, &request, entropy, context) : NULL;
    if (is_filled && refused == NULL)
        return &held->master;
    if (refused != NULL)
        hn_say_wrong(&request, refused, wrong, HN_ERROR_BYTES);
    free_held(held);
    return NULL;
}

hn_slave *hn_make_slave(const char *scene, unsigned axes, hn_entropy *entropy, void *context,
                        char wrong[HN_ERROR_BYTES])
{
    held_slave *held = calloc(1, sizeof *held);
    snprintf(wrong, HN_ERROR_BYTES, "%s", NO_MEMORY);
    if (held == NULL)
        return NULL;
    const char *refused = hn_slave_init(&held->slave, copy(held->scene, scene), axes, entropy, context);
    if (refused == NULL)
        return &held->slave;
    hn_request said = {.name = scene, .axes = axes};
    hn_say_wrong(&said, refused, wrong, HN_ERROR_BYTES);
    free(held);
    return NULL;
}

void hn_free_master(hn_master *m)
{
    free_held((held_master *)m);
}

void hn_free_slave(hn_slave *s)
{
    held_slave *held = (held_slave *)s;
    if (held == NULL)
        return;
#ifdef HN_SEALED
    free_listed(held->listed, held->keys.count);
#endif
    wipe(held, sizeof *held);
    free(held);
}

static uint32_t named(hn_counts counts, const char *name)
{
    return strcmp(name, "malformed") == 0 ? counts.malformed
           : strcmp(name, "stray") == 0   ? counts.stray
           : strcmp(name, "too_old") == 0 ? counts.too_old
                                          : 0;
}

uint32_t hn_master_count(const hn_master *m, const char *name)
{
    return named(hn_master_counts(m), name);
}

uint32_t hn_slave_count(const hn_slave *s, const char *name)
{
    return named(hn_slave_counts(s), name);
}

const char *hn_codec_name(unsigned index)
{
#define NAME_OF(symbol, name, parameters) name,
    static const char *const names[] = {HN_CODECS(NAME_OF)};
    return index < sizeof names / sizeof *names ? names[index] : NULL;
}

size_t hn_datagram_bytes(void)
{
    return HN_DATAGRAM_BYTES;
}

size_t hn_error_bytes(void)
{
    return HN_ERROR_BYTES;
}

unsigned hn_most_axes(void)
{
    return HN_MOST_AXES;
}

#ifdef HN_SEALED

const char *hn_seal_master(hn_master *m, const uint8_t own_private[32], const uint8_t slave_public[32],
                           const uint8_t *psk)
{
    return hn_master_seal(m, &((held_master *)m)->keys, own_private, slave_public, psk);
}

const char *hn_seal_slave(hn_slave *s, const uint8_t own_private[32], const uint8_t *masters, size_t count)
{
    held_slave *held = (held_slave *)s;
    hn_listed *listed = calloc(count + 1, sizeof *listed);
    if (listed == NULL)
        return NO_MEMORY;
    memcpy(listed, masters, count * sizeof *listed);
    const char *wrong = hn_slave_seal(s, &held->keys, own_private, listed, count);
    if (held->keys.listed == listed)
        held->listed = listed;
    else
        free_listed(listed, count);
    return wrong;
}

const char *hn_read_key(const char *path, uint8_t private_key[32], uint8_t psk[32], char wrong[HN_ERROR_BYTES])
{
    return hn_load_key(path, private_key, psk, wrong);
}

const char *hn_read_masters(const char *path, uint8_t *masters, size_t most, size_t *count, char wrong[HN_ERROR_BYTES])
{
    return hn_load_masters(path, (hn_listed *)masters, most, count, wrong);
}

#else

static const char OPEN_ONLY[] = "this libhapticnet was built without libcrypto; sealed sessions and keys need it";

const char *hn_seal_master(hn_master *m, const uint8_t own_private[32], const uint8_t slave_public[32],
                           const uint8_t *psk)
{
    (void)m, (void)own_private, (void)slave_public, (void)psk;
    return OPEN_ONLY;
}

const char *hn_seal_slave(hn_slave *s, const uint8_t own_private[32], const uint8_t *masters, size_t count)
{
    (void)s, (void)own_private, (void)masters, (void)count;
    return OPEN_ONLY;
}

const char *hn_read_key(const char *path, uint8_t private_key[32], uint8_t psk[32], char wrong[HN_ERROR_BYTES])
{
    (void)path, (void)private_key, (void)psk, (void)wrong;
    return OPEN_ONLY;
}

const char *hn_read_masters(const char *path, uint8_t *masters, size_t most, size_t *count, char wrong[HN_ERROR_BYTES])
{
    (void)path, (void)masters, (void)most, (void)wrong;
    *count = 0;
    return OPEN_ONLY;
}

#endif
