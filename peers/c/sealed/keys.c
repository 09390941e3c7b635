/* Key files: the part of TOML that they need, who may read them, and base64 (RFC 4648, section 4). */
#if defined(__unix__) || defined(__APPLE__)
#if !defined(_DEFAULT_SOURCE)
#define _DEFAULT_SOURCE
#endif
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#define HN_HAS_STAT 1
#endif

#include <ctype.h>
#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "crypto.h"
#include "hapticnet_keys.h"

enum { PATH_BYTES = 400, LINE_BYTES = 1000, MOST_LINES = 20000 };

static const char DIGITS[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

void hn_format_key(char text[HN_KEY_TEXT_BYTES], const hn_key key)
{
    for (unsigned i = 0, at = 0; i < HN_KEY_BYTES; i += 3) {
        uint32_t bits = (uint32_t)key[i] << 16 | (uint32_t)key[i + 1] << 8 | (i + 2 < HN_KEY_BYTES ? key[i + 2] : 0u);
        for (unsigned shift = 18; at < 4 * (i / 3 + 1); shift -= 6)
            text[at++] = DIGITS[bits >> shift & 63];
    }
    text[HN_KEY_TEXT_BYTES - 2] = '=';
    text[HN_KEY_TEXT_BYTES - 1] = 0;
}

bool hn_parse_key(hn_key key, const char *text)
{
    char again[HN_KEY_TEXT_BYTES];
    hn_key found;
    uint32_t bits = 0;
    if (strlen(text) != HN_KEY_TEXT_BYTES - 1)
        return false;
    for (unsigned i = 0, size = 0; i < HN_KEY_TEXT_BYTES - 2; i++) {
        const char *digit = strchr(DIGITS, text[i]);
        if (digit == NULL)
            return false;
        bits = bits << 6 | (uint32_t)(digit - DIGITS);
        if (i % 4 != 0 && size < HN_KEY_BYTES)
            found[size++] = (uint8_t)(bits >> (6 - 2 * (i % 4)));
    }
    hn_format_key(again, found); /* two bits of the last digit are unused, but a key has one spelling */
    if (strcmp(again, text) != 0)
        return false;
    memcpy(key, found, sizeof found);
    return true;
}

bool hn_derive_public(hn_key public_key, const hn_key private_key)
{
    return hn_public_of(public_key, private_key);
}

static const char *say(char wrong[HN_WRONG_BYTES], const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(wrong, HN_WRONG_BYTES, format, arguments);
    va_end(arguments);
    return wrong;
}

/* Write the path that was given, or that of a file in hapticnet's folder. */
static const char *find(char path[PATH_BYTES], const char *given, const char *file, char *wrong)
{
    const char *base = getenv("XDG_CONFIG_HOME"), *home = getenv("HOME");
    int size;
    if (given != NULL)
        size = snprintf(path, PATH_BYTES, "%s", given);
    else if (base != NULL && base[0] == '/') /* the specification of base directories: others must be ignored */
        size = snprintf(path, PATH_BYTES, "%s/hapticnet/%s", base, file);
    else if (home != NULL)
        size = snprintf(path, PATH_BYTES, "%s/.config/hapticnet/%s", home, file);
    else
        return say(wrong, "there is no home folder with a %s; name a file", file);
    return size < PATH_BYTES ? NULL : say(wrong, "the path of %s is too long", file);
}

/* Check that only its owner and root can change a file and, if it holds a secret, that only its owner can read it. */
static const char *check_access(FILE *opened, const char *path, bool secret, char *wrong)
{
#ifdef HN_HAS_STAT
    struct stat file;
    char folder[PATH_BYTES + 2];
    if (fstat(fileno(opened), &file) != 0) /* of the file that is read; the path may lead to another by now */
        return say(wrong, "%s: %s", path, strerror(errno));
    if (file.st_uid != 0 && file.st_uid != geteuid())
        return say(wrong, "%s belongs to another account (number %lu), which can change it; run: sudo chown $USER %s",
                   path, (unsigned long)file.st_uid, path);
    if (secret && file.st_mode & (S_IRWXG | S_IRWXO))
        return say(wrong, "%s holds a secret and is accessible to other users (mode %04o); run: chmod 600 %s", path,
                   (unsigned)file.st_mode & 07777u, path);
    if (file.st_mode & (S_IWGRP | S_IWOTH))
        return say(wrong, "%s can be changed by other users (mode %04o); run: chmod go-w %s", path,
                   (unsigned)file.st_mode & 07777u, path);
    snprintf(folder, sizeof folder, "%s", path);
    char *slash = strrchr(folder, '/');
    strcpy(slash != NULL ? slash + 1 : folder, ".");
    if (stat(folder, &file) == 0 && file.st_mode & S_IWOTH && !(file.st_mode & S_ISVTX))
        return say(wrong, "%s can be replaced by all accounts, because they can change its folder; run: chmod o-w %s",
                   path, folder);
#else
    (void)opened, (void)path, (void)secret, (void)wrong;
#endif
    return NULL;
}

/* Open a file: not a pipe or a device, which may have no end. */
static FILE *open_file(const char *path, bool *is_special)
{
    *is_special = false;
#ifdef HN_HAS_STAT
    struct stat file;
    int descriptor = open(path, O_RDONLY | O_NONBLOCK | O_CLOEXEC); /* to open a pipe must not wait for a writer */
    if (descriptor < 0)
        return NULL;
    *is_special = fstat(descriptor, &file) != 0 || !S_ISREG(file.st_mode);
    FILE *opened = *is_special ? NULL : fdopen(descriptor, "r");
    if (opened == NULL)
        close(descriptor);
    return opened;
#else
    return fopen(path, "r");
#endif
}

static char *skip_space(char *at)
{
    while (*at == ' ' || *at == '\t')
        at++;
    return at;
}

/* Whether nothing but a comment follows. */
static bool is_end(char *at)
{
    at = skip_space(at);
    return *at == 0 || *at == '#';
}

/* Split `name = "text"`; false if the line is something else. */
static bool split(char *line, char **name, char **text)
{
    char *at = *name = skip_space(line);
    while (isalnum((unsigned char)*at) || *at == '_')
        at++;
    char *end = at;
    at = skip_space(at);
    if (end == *name || *at != '=')
        return false;
    *end = 0;
    at = skip_space(at + 1);
    char quote = *at;
    if (quote != '"' && quote != '\'')
        return false;
    for (*text = ++at; *at != quote; at++)
        if (*at == 0 || (*at == '\\' && quote == '"' && *++at == 0))
            return false;
    *at = 0;
    return is_end(at + 1);
}

/* Take a key of a file; a secret is not shown. */
static const char *take(hn_key key, const char *path, const char *name, const char *text, bool secret, char *wrong)
{
    static const hn_key zero;
    char seen[HN_KEY_TEXT_BYTES + 6] = "it";
    if (!secret)
        snprintf(seen, sizeof seen, "'%.44s'", text);
    if (!hn_parse_key(key, text))
        return say(wrong, "%s: %s has %u characters; %s must be 44 characters of base64 that end in '=' (32 bytes)",
                   path, name, (unsigned)strlen(text), seen);
    if (strcmp(name, "psk") == 0 && memcmp(key, zero, sizeof zero) == 0)
        return say(wrong, "%s: psk is all zeros, which is not a secret; omit it or use 32 random bytes", path);
    return NULL;
}

typedef struct {
    const char *path;
    char *wrong;
    hn_listed *listed; /* NULL: the file of a key */
    size_t most, count;
    uint8_t *private_key, *psk;
    bool has_private, has_psk, has_public;
} reader;

static const char *read_value(reader *r, unsigned number, const char *name, const char *text)
{
    hn_listed *master = r->listed != NULL && r->count > 0 ? &r->listed[r->count - 1] : NULL;
    bool is_psk = strcmp(name, "psk") == 0, *seen = NULL;
    uint8_t *key = NULL;
    if (is_psk && (r->listed == NULL || master != NULL))
        seen = &r->has_psk, key = master != NULL ? master->psk : r->psk;
    else if (r->listed == NULL && strcmp(name, "private") == 0)
        seen = &r->has_private, key = r->private_key;
    else if (master != NULL && strcmp(name, "public") == 0)
        seen = &r->has_public, key = master->public_key;
    else if (master != NULL && strcmp(name, "name") == 0)
        return NULL; /* for people */
    else
        return say(r->wrong, "%s, line %u: '%s' is not known here", r->path, number, name);
    if (*seen)
        return say(r->wrong, "%s, line %u: %s stands there twice", r->path, number, name);
    *seen = true;
    return take(key, r->path, name, text, seen != &r->has_public, r->wrong);
}

static const char *end_master(const reader *r)
{
    if (r->count > 0 && !r->has_public)
        return say(r->wrong, "%s: master %u has no public key", r->path, (unsigned)r->count);
    for (size_t i = 0; i + 1 < r->count; i++)
        if (memcmp(r->listed[i].public_key, r->listed[r->count - 1].public_key, sizeof(hn_key)) == 0)
            return say(r->wrong, "%s: masters %u and %u have the same public key; each master has its own", r->path,
                       (unsigned)i + 1, (unsigned)r->count);
    return NULL;
}

static const char *begin_master(reader *r)
{
    const char *bad = end_master(r);
    if (bad == NULL && r->count == r->most)
        bad = say(r->wrong, "%s has more than %u masters", r->path, (unsigned)r->most);
    if (bad != NULL)
        return bad;
    memset(&r->listed[r->count++], 0, sizeof *r->listed);
    r->has_public = r->has_psk = false;
    return NULL;
}

static const char *read_lines(reader *r, FILE *file, bool *secret)
{
    char line[LINE_BYTES], *name, *text;
    const char *bad = NULL;
    for (unsigned number = 1; bad == NULL && fgets(line, sizeof line, file) != NULL; number++) {
        size_t size = strlen(line);
        if ((size == 0 || line[size - 1] != '\n') && !feof(file)) { /* its rest would be read as a line */
            bad = say(r->wrong, "%s, line %u has a zero byte, or more than %u bytes", r->path, number, LINE_BYTES - 2u);
            break;
        }
        if (number > MOST_LINES) {
            bad = say(r->wrong, "%s has more than %u lines", r->path, (unsigned)MOST_LINES);
            break;
        }
        line[strcspn(line, "\r\n")] = 0;
        char *at = skip_space(line);
        if (is_end(at))
            continue;
        if (r->listed != NULL && strncmp(at, "[[master]]", 10) == 0 && is_end(at + 10))
            bad = begin_master(r);
        else if (split(line, &name, &text))
            bad = read_value(r, number, name, text);
        else
            bad = say(r->wrong, "%s, line %u is not understood; right would be, for example: %s", r->path, number,
                      r->listed != NULL ? "public = \"<key>\"" : "private = \"<key>\"");
        *secret = *secret || r->has_psk;
    }
    memset(line, 0, sizeof line);
    return bad;
}

static const char *read_file(reader *r, bool secret)
{
    bool is_special;
    FILE *file = open_file(r->path, &is_special);
    if (is_special)
        return say(r->wrong, "%s is not a regular file", r->path);
    if (file == NULL)
        return say(r->wrong, errno == ENOENT ? "%s does not exist; 'hapticnet key new' makes a key" : "%s: %s", r->path,
                   strerror(errno));
    const char *bad = read_lines(r, file, &secret);
    if (bad == NULL && ferror(file))
        bad = say(r->wrong, "%s cannot be read", r->path);
    if (bad == NULL && r->listed != NULL)
        bad = end_master(r);
    if (bad == NULL)
        bad = check_access(file, r->path, secret, r->wrong);
    fclose(file);
    return bad;
}

const char *hn_load_key(const char *path, hn_key private_key, hn_key psk, char wrong[HN_WRONG_BYTES])
{
    char found[PATH_BYTES];
    reader r = {.path = found, .wrong = wrong, .private_key = private_key, .psk = psk};
    const char *bad = find(found, path, "key.toml", wrong);
    memset(psk, 0, sizeof(hn_key));
    if (bad == NULL)
        bad = read_file(&r, true);
    if (bad == NULL && !r.has_private)
        bad = say(wrong, "%s has no line: private = \"<key>\"", found);
    if (bad != NULL) { /* a program that goes on must not use a key that was refused */
        memset(private_key, 0, sizeof(hn_key));
        memset(psk, 0, sizeof(hn_key));
    }
    return bad;
}

const char *hn_load_masters(const char *path, hn_listed listed[], size_t most, size_t *count,
                            char wrong[HN_WRONG_BYTES])
{
    char found[PATH_BYTES];
    reader r = {.path = found, .wrong = wrong, .listed = listed, .most = most};
    const char *bad = find(found, path, "masters.toml", wrong);
    if (bad == NULL)
        bad = read_file(&r, false);
    *count = bad == NULL ? r.count : 0;
    return bad;
}
