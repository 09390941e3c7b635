/* What is wrong with a request, with the value that it has. Only a program that asks for it links this and snprintf. */
#include <stdio.h>
#include <string.h>

#include "codec.h"
#include "messages.h"

static const char *text_in(const hn_request *r, const char *field)
{
    if (strcmp(field, "codec") == 0)
        return r->codec;
    if (strcmp(field, "name") == 0 || strcmp(field, "scene") == 0)
        return r->name;
    if (strcmp(field, "parameter") != 0)
        return NULL;
    hn_settings settings = {.codec = hn_codec_named(hn_text(r->codec))};
    double value;
    unsigned i = 0;
    while (i < HN_MOST_PARAMETERS - 1 && hn_get(&settings, r->parameters[i].name, &value))
        i++;
    return r->parameters[i].name;
}

static const double *number_in(const hn_request *r, const char *field)
{
    const struct {
        const char *name;
        const double *value;
    } numbers[] = {
        {"weber_fraction", &r->weber_fraction},
        {"floor_n", &r->floor_n},
        {"multiplier", &r->multiplier},
        {"rate_hz", &r->rate_hz},
        {"position_share", &r->position_share},
    };
    for (unsigned i = 0; i < sizeof numbers / sizeof *numbers; i++)
        if (strcmp(field, numbers[i].name) == 0)
            return numbers[i].value;
    for (unsigned i = 0; i < HN_MOST_PARAMETERS && r->parameters[i].name != NULL; i++)
        if (strcmp(field, r->parameters[i].name) == 0)
            return &r->parameters[i].value;
    return NULL;
}

const char *hn_say_wrong(const hn_request *request, const char *wrong, char *text, size_t size)
{
    static const char MUST[] = " must be ";
    const char *must = strstr(wrong, MUST);
    char field[32] = "";
    if (must != NULL && must < wrong + sizeof field)
        memcpy(field, wrong, (size_t)(must - wrong));
    const char *seen = text_in(request, field), *right = must != NULL ? must + strlen(MUST) : "";
    const double *number = number_in(request, field);
    if (seen != NULL)
        snprintf(text, size, "%s is '%.*s'; it must be %s", field, 2 * HN_NAME_BYTES, seen, right);
    else if (number != NULL)
        snprintf(text, size, "%s is %.12g; it must be %s", field, *number, right);
    else if (strcmp(field, "axes") == 0)
        snprintf(text, size, "%s is %u; it must be %s", field, request->axes, right);
    else
        snprintf(text, size, "%s", wrong);
    return text;
}
