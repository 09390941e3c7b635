/* Nodes on the heap, whose numbers have names. */
#include "hapticnet_binding.h"

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

/* Overwrite memory that is freed next, which a compiler would leave out. */
static void wipe(void *memory, size_t size)
{
    volatile uint8_t *at = memory;
    while (size-- > 0)
        *at++ = 0;
}

static bool copy(char to[HN_NAME_BYTES + 1], const char *text)
{
    if (text == NULL || strlen(text) > HN_NAME_BYTES)
        return false;
    strcpy(to, text);
    return true;
}

static const char *set_parameter(held_master *held, hn_request *request, const char *name, double value)
{
    for (unsigned i = 0; i < HN_MOST_PARAMETERS; i++)
        if (request->parameters[i].name == NULL && copy(held->parameters[i], name)) {
            request->parameters[i] = (hn_parameter){held->parameters[i], value};
            return NULL;
        }
    return "the codec has no such parameter, or too many are given";
}

/* Set a number of a request by its name. */
static const char *set(held_master *held, hn_request *request, const char *name, double value)
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
            return NULL;
        }
    if (strcmp(name, "axes") == 0)
        request->axes = value >= 1.0 && value <= HN_MOST_AXES ? (unsigned)value : 0;
    else if (strcmp(name, "announced") == 0)
        request->announced = value != 0.0;
    else if (strcmp(name, "predicted") == 0)
        request->predicted = value != 0.0;
    else
        return set_parameter(held, request, name, value);
    return NULL;
}

static const char *fill(held_master *held, hn_request *request, const char *codec, const char *name,
                        const char *const names[], const double values[], size_t count)
{
    const char *wrong = NULL;
    if (!copy(held->codec, codec))
        return "there is no such codec";
    if (!copy(held->name, name))
        return "the name must be at most 64 bytes of printable UTF-8";
    request->codec = held->codec;
    request->name = held->name;
    for (size_t i = 0; i < count && wrong == NULL; i++)
        wrong = set(held, request, names[i], values[i]);
    size_t more_bytes = wrong == NULL ? hn_more_bytes(request) : 0;
    if (more_bytes == 0)
        return wrong;
    held->more = malloc(more_bytes);
    if (held->more == NULL)
        return "there is no memory";
    request->more = hn_more_init(held->more, request);
    return NULL;
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
                          size_t count, hn_entropy *entropy, void *context, const char **wrong)
{
    hn_request request = {
        .weber_fraction = HN_DEFAULT_WEBER_FRACTION,
        .floor_n = HN_DEFAULT_FLOOR_N,
        .multiplier = HN_DEFAULT_MULTIPLIER,
        .rate_hz = HN_DEFAULT_RATE_HZ,
        .axes = 1,
    };
    held_master *held = calloc(1, sizeof *held);
    *wrong = held == NULL ? "there is no memory" : fill(held, &request, codec, name, names, values, count);
    if (*wrong == NULL)
        *wrong = hn_master_init(&held->master, &request, entropy, context);
    if (*wrong == NULL)
        return &held->master;
    free_held(held);
    return NULL;
}

hn_slave *hn_make_slave(const char *scene, unsigned axes, hn_entropy *entropy, void *context, const char **wrong)
{
    held_slave *held = calloc(1, sizeof *held);
    *wrong = held == NULL                      ? "there is no memory"
             : axes < 1 || axes > HN_MOST_AXES ? "the axes must be 1 to 3"
             : !copy(held->scene, scene) || !hn_is_text(hn_text(scene), HN_NAME_BYTES)
                 ? "the scene's name must be at most 64 bytes of printable UTF-8"
                                               : NULL;
    if (*wrong != NULL) {
        free(held);
        return NULL;
    }
    hn_slave_init(&held->slave, held->scene, axes, entropy, context);
    return &held->slave;
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
    if (held->listed != NULL)
        wipe(held->listed, held->keys.count * sizeof *held->listed);
    free(held->listed);
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
#define NAME_OF(symbol, name) name,
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
    if (m->sealing != NULL || m->tried) /* the stream that it has would get keys of zeros */
        return "a master is sealed once, before its first tick";
    bool good = hn_master_seal(m, &((held_master *)m)->keys, own_private, slave_public, psk);
    return good ? NULL : "the slave's public key is not one, or libcrypto lacks X25519, as in FIPS mode";
}

const char *hn_seal_slave(hn_slave *s, const uint8_t own_private[32], const uint8_t *masters, size_t count)
{
    held_slave *held = (held_slave *)s;
    if (held->listed != NULL)
        return "this slave is sealed already";
    held->listed = calloc(count + 1, sizeof *held->listed);
    if (held->listed == NULL)
        return "there is no memory";
    memcpy(held->listed, masters, count * sizeof *held->listed);
    bool good = hn_slave_seal(s, &held->keys, own_private, held->listed, count);
    return good ? NULL : "libcrypto lacks X25519, as in FIPS mode";
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
