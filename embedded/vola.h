/*
 * vola.h - a reader of VOLA volumes (.vol, .dvol) for small devices. C99, one file, no allocation.
 *
 * In ONE source file:    #define VOLA_IMPLEMENTATION
 *                        #include "vola.h"
 * in the others:         #include "vola.h"
 *
 * The whole file, not gzipped, must be in memory that can be read (flash, mmap, a buffer). It is
 * never copied, needs no alignment, and is read byte by byte, so the byte order of the machine does
 * not matter. Of the C library only <stddef.h>, <stdint.h> and memcmp, memcpy, memset are used.
 *
 * Defined before the implementation is included:
 *   VOLA_STATIC       all functions are static inline
 *   VOLA_NO_DOUBLE    no floating point: no coordinates, cells only
 *   VOLA_POPCOUNT(w)  your number of set bits of a uint64_t
 *
 * Format: docs/format.md of volatool. Licence: Apache-2.0 (LICENSE beside the repository's README).
 */
#ifndef VOLA_H
#define VOLA_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifdef VOLA_STATIC
#define VOLA_DEF static inline
#else
#define VOLA_DEF extern
#endif

#define VOLA_MAX_DEPTH 15
#define VOLA_HEADER_BYTES 80
#define VOLA_RANK_STRIDE 8 /* words of a level to one number of the rank directory */

/* Named as volatool's codes; vola_code() gives the text. */
typedef enum vola_status {
    VOLA_OK = 0,
    VOLA_E_NOT_VOLA,  /* not the first bytes of a VOLA file (gzip is not unpacked here) */
    VOLA_E_TRUNCATED, /* the file ends early */
    VOLA_E_CORRUPT,   /* it contradicts itself, or a checksum does not match */
    VOLA_E_SIZE,      /* more levels, or more cells, than this reader can count */
    VOLA_E_OPTION     /* an argument that can't be used: too little memory for the directory */
} vola_status;

enum { VOLA_SPARSE = 0, VOLA_DENSE = 1 };                        /* vola.mode */
enum { VOLA_UNKNOWN = 0, VOLA_FLOOR = 1, VOLA_TOOLKIT = 2 };     /* vola.quantizer */
enum { VOLA_W_ZERO_METADATA = 1, VOLA_W_EMPTY_BLOCKS = 2 };      /* bits of vola.warnings */
enum { VOLA_CHECK_ALL = 0, VOLA_SKIP_CHECKSUMS = 1 };            /* flags of vola_open */

typedef struct vola_level {
    size_t words;         /* offset of the occupancy words */
    size_t metadata;      /* offset of the metadata words, 0 if the file has none */
    size_t count;         /* words: stored blocks of a sparse file, strips of a dense one */
    uint64_t cells;       /* bits set */
    const uint32_t *rank; /* set bits before every VOLA_RANK_STRIDE words, NULL without directory */
} vola_level;

/* An opened file. Read its members, don't write them; copy it freely. */
typedef struct vola {
    const uint8_t *data;
    size_t size;
    size_t body;      /* bytes of header and levels */
    size_t fault;     /* where vola_open found the fault */
    const char *json; /* the trailer's JSON, not terminated; NULL without a trailer */
    size_t json_size;
    uint32_t crs; /* horizontal EPSG code; 0 or 2000: not known */
    uint8_t mode, depth, has_metadata, quantizer, warnings;
    vola_level level[VOLA_MAX_DEPTH]; /* [0] is the root, level 1 of the functions */
#ifndef VOLA_NO_DOUBLE
    double lat, lon, box[6];  /* as in the header; lat and lon may be anything */
    double corner[3], side;   /* the cube, in the horizontal unit, z too */
    double z_ratio;           /* horizontal units per vertical unit */
#endif
} vola;

/* A walk over the cells of one level, in VOLA order. */
typedef struct vola_iter {
    const vola *volume;
    int32_t x, y, z;   /* the cell, after vola_next() returned 1 */
    size_t block;      /* sparse: number of its block among the level's words */
    int level, at;
    int32_t block_x, block_y, block_z;
    size_t next[VOLA_MAX_DEPTH];
    uint64_t left[VOLA_MAX_DEPTH];
} vola_iter;

/* "E_CORRUPT", ...; "OK". */
VOLA_DEF const char *vola_code(vola_status status);

/* Check the 80 bytes of a header and fill in what it tells; size is that of the whole data, of
 * which no more than the header is read. */
VOLA_DEF vola_status vola_read_header(vola *v, const void *data, size_t size);

/* Check a whole file. Reads every word once. On failure *v is not to be used, but for v->fault. */
VOLA_DEF vola_status vola_open(vola *v, const void *data, size_t size, unsigned flags);

/* Optional: memory for a rank directory makes look-ups in sparse files O(depth). The numbers that
 * it takes (0 for dense files), and its building; it must live as long as *v. */
VOLA_DEF size_t vola_rank_size(const vola *v);
VOLA_DEF vola_status vola_build_rank(vola *v, uint32_t *memory, size_t size);

/* Cells set at a level (1 to v->depth), 0 for other levels. Voxels: vola_count(v, v->depth). */
VOLA_DEF uint64_t vola_count(const vola *v, int level);

/* 1 if the cell is set, 0 if it is not, or outside the grid, or the level does not exist. */
VOLA_DEF int vola_is_set(const vola *v, int level, int32_t x, int32_t y, int32_t z);
VOLA_DEF int vola_contains(const vola *v, int32_t x, int32_t y, int32_t z);

/* 1 and the metadata word of a set cell: that of its block (dense: of its strip of 64 cells).
 * Byte c is (word >> 8 * c) & 255. 0 if the cell is not set or the file has no metadata. */
VOLA_DEF int vola_metadata(const vola *v, int level, int32_t x, int32_t y, int32_t z,
                           uint64_t *word);

/* The words as they are stored; 0 outside. */
VOLA_DEF uint64_t vola_word(const vola *v, int level, size_t number);
VOLA_DEF uint64_t vola_metadata_word(const vola *v, int level, size_t number);

/* vola_iter it; vola_begin(&it, v, level); while (vola_next(&it)) use(it.x, it.y, it.z); */
VOLA_DEF void vola_begin(vola_iter *it, const vola *v, int level);
VOLA_DEF int vola_next(vola_iter *it);
VOLA_DEF int vola_iter_metadata(const vola_iter *it, uint64_t *word);

/* The value of a member of a JSON object, as a piece of its text (strings with their quotes). 1 if
 * it is there. vola_member(v->json, v->json_size, "crs", &crs, &n), then of crs its "wkt2". */
VOLA_DEF int vola_member(const char *json, size_t size, const char *key, const char **value,
                         size_t *value_size);

/* CRC-32 as in zlib; start with 0. */
VOLA_DEF uint32_t vola_crc32(uint32_t crc, const void *data, size_t size);

#ifndef VOLA_NO_DOUBLE
/* Edge of a cell of a level, in the horizontal unit. */
VOLA_DEF double vola_edge(const vola *v, int level);

/* 1 and the cell that a point falls into (x, y in the horizontal unit, z in the VERTICAL one), 0
 * outside the closed cube or not finite. A point within rounding of a face is on it. */
VOLA_DEF int vola_locate(const vola *v, int level, const double xyz[3], int32_t cell[3]);

/* 1 if the voxel that a point falls into is set. */
VOLA_DEF int vola_contains_point(const vola *v, const double xyz[3]);

/* The best estimate of where the points of a cell are, z in the vertical unit. */
VOLA_DEF void vola_centre(const vola *v, int level, const int32_t cell[3], double xyz[3]);
#endif

#ifdef __cplusplus
}
#endif
#endif /* VOLA_H */

#ifdef VOLA_IMPLEMENTATION
#ifndef VOLA_IMPLEMENTED
#define VOLA_IMPLEMENTED

#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

#define VOLA__MAX_TRAILER ((size_t)1 << 20)
#define VOLA__FRAME 32

/* ---------------------------------------------------------------------------- bytes and bits */

static uint32_t vola__u32(const uint8_t *p) {
    return (uint32_t)p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static uint64_t vola__u64(const uint8_t *p) {
    return (uint64_t)vola__u32(p) | (uint64_t)vola__u32(p + 4) << 32;
}

static unsigned vola__popcount(uint64_t w) {
#ifdef VOLA_POPCOUNT
    return (unsigned)VOLA_POPCOUNT(w);
#else
    /* two halves: most small devices have no 64-bit registers and no multiplication of 64 bits */
    uint32_t half[2];
    unsigned i, n = 0;
    half[0] = (uint32_t)w;
    half[1] = (uint32_t)(w >> 32);
    for (i = 0; i < 2; i++) {
        uint32_t h = half[i];
        h -= (h >> 1) & 0x55555555u;
        h = (h & 0x33333333u) + ((h >> 2) & 0x33333333u);
        h = (h + (h >> 4)) & 0x0f0f0f0fu;
        n += (unsigned)((h * 0x01010101u) >> 24);
    }
    return n;
#endif
}

VOLA_DEF uint32_t vola_crc32(uint32_t crc, const void *data, size_t size) {
    static const uint32_t table[16] = {0x00000000u, 0x1db71064u, 0x3b6e20c8u, 0x26d930acu,
                                       0x76dc4190u, 0x6b6b51f4u, 0x4db26158u, 0x5005713cu,
                                       0xedb88320u, 0xf00f9344u, 0xd6d6a3e8u, 0xcb61b38cu,
                                       0x9b64c2b0u, 0x86d3d2d4u, 0xa00ae278u, 0xbdbdf21cu};
    const uint8_t *p = (const uint8_t *)data;
    crc = ~crc;
    while (size--) {
        crc ^= *p++;
        crc = crc >> 4 ^ table[crc & 15];
        crc = crc >> 4 ^ table[crc & 15];
    }
    return ~crc;
}

VOLA_DEF const char *vola_code(vola_status status) {
    switch (status) {
    case VOLA_OK: return "OK";
    case VOLA_E_NOT_VOLA: return "E_NOT_VOLA";
    case VOLA_E_TRUNCATED: return "E_TRUNCATED";
    case VOLA_E_CORRUPT: return "E_CORRUPT";
    case VOLA_E_SIZE: return "E_SIZE";
    case VOLA_E_OPTION: return "E_OPTION";
    }
    return "E_INTERNAL";
}

static vola_status vola__fault(vola *v, vola_status status, size_t offset) {
    v->fault = offset;
    return status;
}

/* ------------------------------------------------------------------------------------ header */

#ifndef VOLA_NO_DOUBLE
/* a double must be an IEEE 754 binary64; AVR's is not: define VOLA_NO_DOUBLE there */
typedef char vola__double_has_8_bytes[sizeof(double) == 8 ? 1 : -1];

static double vola__f64(const uint8_t *p) {
    uint64_t bits = vola__u64(p);
    double value;
    memcpy(&value, &bits, 8);
    return value;
}

static double vola__abs(double value) { return value < 0 ? -value : value; }

static int vola__finite(double value) { return value - value == 0; }

static double vola__box_side(const vola *v) {
    double side = 0;
    int axis;
    for (axis = 0; axis < 3; axis++) {
        double extent = v->box[3 + axis] - v->box[axis];
        if (!(extent <= side)) side = extent;
    }
    return side;
}
#endif

/* Whether two float64 are finite and the first is not above the second, by their bits. */
static int vola__in_order(const uint8_t *low, const uint8_t *high) {
    const uint64_t sign = (uint64_t)1 << 63, exponent = (uint64_t)0x7ff << 52;
    uint64_t a = vola__u64(low), b = vola__u64(high);
    if ((a & exponent) == exponent || (b & exponent) == exponent) return 0;
    if (!((a | b) & ~sign)) return 1; /* zeros of any sign */
    a = a & sign ? ~a : a | sign;
    b = b & sign ? ~b : b | sign;
    return a <= b;
}

VOLA_DEF vola_status vola_read_header(vola *v, const void *data, size_t size) {
    static const uint8_t start[6] = {VOLA_HEADER_BYTES, 0, 0, 0, 1, 0};
    const uint8_t *p = (const uint8_t *)data;
    int axis;
    memset(v, 0, sizeof *v);
    v->data = p;
    v->size = size;
    if (size == 0 || memcmp(p, start, size < 6 ? size : 6) != 0)
        return vola__fault(v, VOLA_E_NOT_VOLA, 0);
    if (size < VOLA_HEADER_BYTES) return vola__fault(v, VOLA_E_TRUNCATED, size);
    v->mode = p[6];
    v->depth = p[7];
    if (v->mode > VOLA_DENSE) return vola__fault(v, VOLA_E_CORRUPT, 6);
    if (v->depth < 1) return vola__fault(v, VOLA_E_CORRUPT, 7);
    if (v->depth > VOLA_MAX_DEPTH) return vola__fault(v, VOLA_E_SIZE, 7);
    if (vola__u32(p + 8) > 1) return vola__fault(v, VOLA_E_CORRUPT, 8);
    v->has_metadata = p[8];
    v->crs = vola__u32(p + 12);
    for (axis = 0; axis < 3; axis++)
        if (!vola__in_order(p + 32 + 8 * axis, p + 56 + 8 * axis))
            return vola__fault(v, VOLA_E_CORRUPT, 32);
#ifndef VOLA_NO_DOUBLE
    v->lat = vola__f64(p + 16);
    v->lon = vola__f64(p + 24);
    for (axis = 0; axis < 6; axis++) v->box[axis] = vola__f64(p + 32 + 8 * axis);
    for (axis = 0; axis < 3; axis++) v->corner[axis] = v->box[axis];
    v->side = vola__box_side(v);
    v->z_ratio = 1;
    if (!vola__finite(v->side)) return vola__fault(v, VOLA_E_CORRUPT, 32);
#endif
    v->body = VOLA_HEADER_BYTES;
    return VOLA_OK;
}

/* ------------------------------------------------------------------------------------ levels */

static uint64_t vola__word_at(const vola *v, int i, size_t number) {
    return vola__u64(v->data + v->level[i].words + 8 * number);
}

/* Take the next words of the file: their offset goes to *at. */
static vola_status vola__take(vola *v, size_t count, size_t *at) {
    if (count > (v->size - v->body) / 8) return vola__fault(v, VOLA_E_TRUNCATED, v->size);
    *at = v->body;
    v->body += 8 * count;
    return VOLA_OK;
}

static vola_status vola__sparse_levels(vola *v, int has_metadata) {
    uint64_t count = 1;
    int i;
    v->body = VOLA_HEADER_BYTES;
    v->warnings = 0;
    for (i = 0; i < v->depth; i++) {
        vola_level *level = &v->level[i];
        vola_status status;
        size_t n;
        if (count > (v->size - v->body) / 8) return vola__fault(v, VOLA_E_TRUNCATED, v->size);
        level->count = (size_t)count;
        level->metadata = 0;
        status = vola__take(v, level->count, &level->words);
        if (status == VOLA_OK && has_metadata)
            status = vola__take(v, level->count, &level->metadata);
        if (status != VOLA_OK) return status;
        count = 0;
        for (n = 0; n < level->count; n++) {
            uint64_t word = vola__word_at(v, i, n);
            if (word == 0 && i > 0) {
                if (has_metadata) return vola__fault(v, VOLA_E_CORRUPT, level->words + 8 * n);
                v->warnings |= VOLA_W_EMPTY_BLOCKS;
            }
            count += vola__popcount(word);
        }
        level->cells = count;
    }
    return VOLA_OK;
}

/* 1 if strip bits of the cell are set; i counts from 0, x, y, z are in the grid. */
static int vola__strip_bit(const vola *v, int i, int32_t x, int32_t y, int32_t z) {
    int edge = 2 * (i + 1); /* linear = x + y * 4^level + z * 16^level */
    uint64_t linear = (uint64_t)x | (uint64_t)y << edge | (uint64_t)z << 2 * edge;
    return (int)(vola__word_at(v, i, (size_t)(linear >> 6)) >> (linear & 63) & 1);
}

/* The word of a 4 x 4 x 4 block of a dense file, put together from 16 rows of 4 bits. */
static uint64_t vola__dense_block(const vola *v, int i, int32_t x, int32_t y, int32_t z) {
    int edge = 2 * (i + 1), row;
    uint64_t word = 0;
    for (row = 0; row < 16; row++) {
        uint64_t linear = (uint64_t)x << 2 | (uint64_t)(4 * y + (row & 3)) << edge |
                          (uint64_t)(4 * z + (row >> 2)) << 2 * edge;
        uint64_t strip = vola__word_at(v, i, (size_t)(linear >> 6));
        word |= (strip >> (linear & 63) & 15) << 4 * row;
    }
    return word;
}

/* Each cell lies in a set cell of the level above, and each of those has one in it. */
static int vola__dense_agrees(const vola *v, int i) {
    int edge = 2 * (i + 1);
    uint64_t mask = ((uint64_t)1 << edge) - 1;
    const vola_level *level = &v->level[i], *above = &v->level[i - 1];
    size_t n;
    for (n = 0; n < level->count; n++) {
        uint64_t word = vola__word_at(v, i, n);
        while (word) {
            uint64_t low = word & (~word + 1);
            uint64_t linear = (uint64_t)n << 6 | vola__popcount(low - 1);
            if (!vola__strip_bit(v, i - 1, (int32_t)((linear & mask) >> 2),
                                 (int32_t)((linear >> edge & mask) >> 2),
                                 (int32_t)((linear >> 2 * edge) >> 2)))
                return 0;
            word ^= low;
        }
    }
    edge -= 2;
    mask >>= 2;
    for (n = 0; n < above->count; n++) {
        uint64_t word = vola__word_at(v, i - 1, n);
        while (word) {
            uint64_t low = word & (~word + 1);
            uint64_t linear = (uint64_t)n << 6 | vola__popcount(low - 1);
            if (!vola__dense_block(v, i, (int32_t)(linear & mask),
                                   (int32_t)(linear >> edge & mask),
                                   (int32_t)(linear >> 2 * edge)))
                return 0;
            word ^= low;
        }
    }
    return 1;
}

static vola_status vola__dense_levels(vola *v) {
    size_t count = 1, left = (v->size - v->body) / 8;
    int i;
    /* all levels must be there before one is looked at; 64^i passes any size_t, so step by step */
    for (i = 0; i < v->depth; i++) {
        size_t n = v->has_metadata ? 2 : 1;
        if (i > 0) {
            if (count > left / 64) return vola__fault(v, VOLA_E_TRUNCATED, v->size);
            count *= 64;
        }
        if (count > left / n) return vola__fault(v, VOLA_E_TRUNCATED, v->size);
        left -= n * count;
        v->level[i].count = count;
        (void)vola__take(v, count, &v->level[i].words);
        if (v->has_metadata) (void)vola__take(v, count, &v->level[i].metadata);
    }
    for (i = 0; i < v->depth; i++) {
        vola_level *level = &v->level[i];
        size_t n;
        for (n = 0; n < level->count; n++) level->cells += vola__popcount(vola__word_at(v, i, n));
        if (i > 0 && !vola__dense_agrees(v, i))
            return vola__fault(v, VOLA_E_CORRUPT, level->words);
    }
    return VOLA_OK;
}

/* -------------------------------------------------------------------------------------- JSON */

static const char *vola__blank(const char *p, const char *end) {
    while (p < end && (*p == ' ' || *p == '\t' || *p == '\n' || *p == '\r')) p++;
    return p;
}

static const char *vola__string_end(const char *p, const char *end) {
    for (p++; p < end; p++) {
        if (*p == '\\') {
            if (++p == end) return NULL;
        } else if (*p == '"') {
            return p + 1;
        }
    }
    return NULL;
}

/* The end of the value that begins at p (after blanks), NULL if there is none. Not recursive. */
static const char *vola__value_end(const char *p, const char *end) {
    size_t nested = 0;
    do {
        p = vola__blank(p, end);
        if (p == end) return NULL;
        if (*p == '"') {
            p = vola__string_end(p, end);
            if (!p) return NULL;
        } else if (*p == '{' || *p == '[') {
            nested++;
            p++;
        } else if (*p == '}' || *p == ']') {
            if (nested == 0) return NULL;
            nested--;
            p++;
        } else if (*p == ',' || *p == ':') {
            if (nested == 0) return NULL;
            p++;
        } else {
            while (p < end && *p != ',' && *p != ':' && *p != '{' && *p != '}' && *p != '[' &&
                   *p != ']' && *p != '"' && *p != ' ' && *p != '\t' && *p != '\n' && *p != '\r')
                p++;
        }
    } while (nested);
    return p;
}

VOLA_DEF int vola_member(const char *json, size_t size, const char *key, const char **value,
                         size_t *value_size) {
    const char *p, *end, *stop;
    size_t key_size = strlen(key);
    int found = 0;
    if (!json) return 0;
    end = json + size;
    p = vola__blank(json, end);
    if (p == end || *p != '{') return 0;
    p = vola__blank(p + 1, end);
    while (p < end && *p == '"') {
        const char *name = p + 1;
        int is_it;
        p = vola__string_end(p, end);
        if (!p) return 0;
        is_it = (size_t)(p - 1 - name) == key_size && memcmp(name, key, key_size) == 0;
        p = vola__blank(p, end);
        if (p == end || *p != ':') return 0;
        p = vola__blank(p + 1, end);
        stop = vola__value_end(p, end);
        if (!stop) return 0;
        if (is_it) { /* of members of one name the last counts, as everywhere */
            *value = p;
            *value_size = (size_t)(stop - p);
            found = 1;
        }
        p = vola__blank(stop, end);
        if (p == end) return 0;
        if (*p == '}') return found;
        if (*p != ',') return 0;
        p = vola__blank(p + 1, end);
    }
    return 0;
}

static int vola__text_is(const char *value, size_t size, const char *text) {
    size_t n = strlen(text);
    return size == n + 2 && value[0] == '"' && memcmp(value + 1, text, n) == 0;
}

/* The next element of an array: *p stands on '[' or ',' before it. */
static int vola__element(const char **p, const char *end, const char **value, size_t *size) {
    const char *stop;
    if (*p == end || (**p != '[' && **p != ',')) return 0;
    *value = vola__blank(*p + 1, end);
    stop = vola__value_end(*value, end);
    if (!stop) return 0;
    *size = (size_t)(stop - *value);
    *p = vola__blank(stop, end);
    return 1;
}

static int vola__blocks_agree(const vola *v, const char *blocks, size_t size) {
    const char *p = blocks, *end = blocks + size, *value;
    size_t n, k;
    int i;
    for (i = 0; i < v->depth; i++) {
        uint64_t count = 0;
        if (!vola__element(&p, end, &value, &n) || n == 0 || n > 19) return 0;
        for (k = 0; k < n; k++) {
            if (value[k] < '0' || value[k] > '9') return 0;
            count = 10 * count + (uint64_t)(value[k] - '0');
        }
        if (count != v->level[i].count) return 0;
    }
    return p < end && *p == ']';
}

/* ----------------------------------------------------------------------------------- trailer */

#ifndef VOLA_NO_DOUBLE
/* A whole number: its first 18 digits, and how many more there are. */
typedef struct vola__whole {
    uint64_t digits;
    int more;
} vola__whole;

static double vola__double_of(uint64_t value) {
    return (double)(uint32_t)(value >> 32) * 4294967296.0 + (double)(uint32_t)value;
}

static const char *vola__read_whole(const char *p, const char *end, vola__whole *whole) {
    const char *start = p;
    whole->digits = 0;
    whole->more = 0;
    for (; p < end && *p >= '0' && *p <= '9'; p++) {
        if (whole->digits < 100000000000000000u)
            whole->digits = 10 * whole->digits + (uint64_t)(*p - '0');
        else
            whole->more++;
    }
    return p > start && p - start <= 400 ? p : NULL;
}

typedef struct vola__ratio {
    vola__whole top, bottom;
    int is_negative;
} vola__ratio;

/* "n/d" with its quotes, as the trailer has its ratios. */
static int vola__read_ratio(const char *value, size_t size, vola__ratio *ratio) {
    const char *p = value + 1, *end = value + size - 1;
    if (size < 5 || value[0] != '"') return 0;
    ratio->is_negative = *p == '-';
    p = vola__read_whole(p + ratio->is_negative, end, &ratio->top);
    if (!p || p == end || *p != '/') return 0;
    p = vola__read_whole(p + 1, end, &ratio->bottom);
    return p == end && ratio->bottom.digits != 0;
}

static int vola__is_exact(const vola__ratio *r) {
    const uint64_t limit = (uint64_t)1 << 53;
    return !r->top.more && !r->bottom.more && r->top.digits <= limit && r->bottom.digits <= limit;
}

/* Correctly rounded if both numbers are at most 2^53, else to some units in the last place. */
static double vola__ratio_value(const vola__ratio *r) {
    double value = vola__double_of(r->top.digits) / vola__double_of(r->bottom.digits);
    int power = r->top.more - r->bottom.more;
    for (; power > 0; power--) value *= 10;
    for (; power < 0; power++) value /= 10;
    return r->is_negative ? -value : value;
}

/* The unit in the last place of the largest number of the box, at least. */
static double vola__box_ulp(const vola *v) {
    double largest = 0;
    int i;
    for (i = 0; i < 6; i++)
        if (vola__abs(v->box[i]) > largest) largest = vola__abs(v->box[i]);
    return largest * 2.220446049250313e-16;
}

static int vola__read_cube(vola *v, const char *cube, size_t size) {
    const char *value, *p, *end;
    size_t n;
    vola__ratio ratio;
    int axis;
    if (!vola_member(cube, size, "origin", &value, &n)) return 0;
    p = value;
    end = value + n;
    for (axis = 0; axis < 3; axis++) {
        double place, slack;
        if (!vola__element(&p, end, &value, &n) || !vola__read_ratio(value, n, &ratio)) return 0;
        place = vola__ratio_value(&ratio);
        slack = vola__is_exact(&ratio) ? 0 : 1e-13 * vola__abs(v->box[axis]);
        if (!(vola__abs(place - v->box[axis]) <= slack)) return 0;
    }
    if (!vola_member(cube, size, "side", &value, &n) || !vola__read_ratio(value, n, &ratio))
        return 0;
    v->side = vola__ratio_value(&ratio);
    /* the header's side went through a subtraction of large coordinates */
    return v->side >= 0 && vola__abs(v->side - vola__box_side(v)) <= 8 * vola__box_ulp(v);
}

static int vola__read_units(vola *v, const char *crs, size_t size) {
    const char *xy, *z;
    size_t n_xy, n_z;
    vola__ratio a, b;
    double top, bottom;
    const double limit = 9007199254740992.0;
    if (!vola_member(crs, size, "metres_per_unit_xy", &xy, &n_xy) ||
        !vola_member(crs, size, "metres_per_unit_z", &z, &n_z))
        return 0;
    if ((n_xy == 4 && memcmp(xy, "null", 4) == 0) || (n_z == 4 && memcmp(z, "null", 4) == 0))
        return 1;
    if (!vola__read_ratio(z, n_z, &a) || !vola__read_ratio(xy, n_xy, &b)) return 0;
    top = vola__double_of(a.top.digits) * vola__double_of(b.bottom.digits);
    bottom = vola__double_of(a.bottom.digits) * vola__double_of(b.top.digits);
    if (a.is_negative || b.is_negative || top == 0 || bottom == 0) return 0;
    if (vola__is_exact(&a) && vola__is_exact(&b) && top <= limit && bottom <= limit)
        v->z_ratio = top / bottom; /* one rounding only */
    else
        v->z_ratio = vola__ratio_value(&a) / vola__ratio_value(&b);
    return vola__finite(v->z_ratio) && v->z_ratio > 0;
}
#endif

/* What of the JSON this reader needs; the rest is not looked at. */
static int vola__read_json(vola *v) {
    const char *value;
    size_t n;
    if (!vola_member(v->json, v->json_size, "schema", &value, &n) ||
        !vola__text_is(value, n, "volatool.trailer/1"))
        return 0;
    if (!vola_member(v->json, v->json_size, "quantizer", &value, &n)) return 0;
    if (vola__text_is(value, n, "floor"))
        v->quantizer = VOLA_FLOOR;
    else if (vola__text_is(value, n, "toolkit"))
        v->quantizer = VOLA_TOOLKIT;
    else if (!vola__text_is(value, n, "unknown"))
        return 0;
    if (!vola_member(v->json, v->json_size, "blocks", &value, &n) ||
        !vola__blocks_agree(v, value, n))
        return 0;
#ifndef VOLA_NO_DOUBLE
    if (!vola_member(v->json, v->json_size, "cube", &value, &n) || !vola__read_cube(v, value, n))
        return 0;
    if (!vola_member(v->json, v->json_size, "crs", &value, &n) || !vola__read_units(v, value, n))
        return 0;
#endif
    return 1;
}

static vola_status vola__read_trailer(vola *v, unsigned flags) {
    static const uint8_t magic[8] = {'V', 'O', 'L', 'A', 'T', 'R', 'L', '1'};
    static const uint8_t last[8] = {'1', 'L', 'R', 'T', 'A', 'L', 'O', 'V'};
    const uint8_t *p = v->data + v->body, *checks;
    size_t rest = v->size - v->body, length;
    if (rest == 0) return VOLA_OK;
    if (memcmp(p, magic, rest < 8 ? rest : 8) != 0)
        return vola__fault(v, VOLA_E_CORRUPT, v->body);
    if (rest < 12) return vola__fault(v, VOLA_E_TRUNCATED, v->size);
    length = vola__u32(p + 8);
    if (length > VOLA__MAX_TRAILER - VOLA__FRAME)
        return vola__fault(v, VOLA_E_CORRUPT, v->body + 8);
    if (rest < length + VOLA__FRAME) return vola__fault(v, VOLA_E_TRUNCATED, v->size);
    if (rest > length + VOLA__FRAME)
        return vola__fault(v, VOLA_E_CORRUPT, v->body + length + VOLA__FRAME);
    checks = p + 12 + length;
    if (vola__u32(checks + 8) != length || memcmp(checks + 12, last, 8) != 0)
        return vola__fault(v, VOLA_E_CORRUPT, v->body + 20 + length);
    if (!(flags & VOLA_SKIP_CHECKSUMS)) {
        if (vola__u32(checks + 4) != vola_crc32(0, p + 12, length))
            return vola__fault(v, VOLA_E_CORRUPT, v->body + 16 + length);
        if (vola__u32(checks) != vola_crc32(0, v->data, v->body))
            return vola__fault(v, VOLA_E_CORRUPT, 0);
    }
    v->json = (const char *)(p + 12);
    v->json_size = length;
    if (!vola__read_json(v)) return vola__fault(v, VOLA_E_CORRUPT, v->body + 12);
    return VOLA_OK;
}

/* The toolkit's writer leaves out metadata words of zero. If it left out all of them there is one
 * reading: the file without metadata, to its last byte. Our own files when cut look like that at
 * times; byte 7 of the root's metadata word, which is 1 there, gives them away. */
static int vola__repair(vola *v) {
    if (vola__sparse_levels(v, 0) != VOLA_OK || v->warnings || v->body != v->size) return 0;
    if (v->depth > 1 && v->level[v->depth - 1].cells &&
        v->data[v->level[1].words + 7] == 1)
        return 0;
    v->warnings = VOLA_W_ZERO_METADATA;
    return 1;
}

VOLA_DEF vola_status vola_open(vola *v, const void *data, size_t size, unsigned flags) {
    vola_status status = vola_read_header(v, data, size);
    size_t fault;
    if (status != VOLA_OK) return status;
    if (v->mode == VOLA_DENSE)
        status = vola__dense_levels(v);
    else
        status = vola__sparse_levels(v, v->has_metadata);
    if (status == VOLA_OK) status = vola__read_trailer(v, flags);
    if (status == VOLA_OK || v->mode == VOLA_DENSE || !v->has_metadata) return status;
    fault = v->fault;
    v->json = NULL;
    v->json_size = 0;
    if (vola__repair(v)) {
        v->quantizer = VOLA_UNKNOWN;
#ifndef VOLA_NO_DOUBLE
        v->side = vola__box_side(v);
        v->z_ratio = 1;
#endif
        return VOLA_OK;
    }
    return vola__fault(v, status, fault);
}

/* ----------------------------------------------------------------------------------- look-up */

VOLA_DEF size_t vola_rank_size(const vola *v) {
    size_t size = 0;
    int i;
    if (v->mode == VOLA_DENSE) return 0;
    for (i = 0; i + 1 < v->depth; i++) /* nothing lies below the last level */
        size += (v->level[i].count + VOLA_RANK_STRIDE - 1) / VOLA_RANK_STRIDE;
    return size;
}

VOLA_DEF vola_status vola_build_rank(vola *v, uint32_t *memory, size_t size) {
    int i;
    if (v->mode == VOLA_DENSE) return VOLA_OK;
    if (size < vola_rank_size(v)) return VOLA_E_OPTION;
    for (i = 0; i + 1 < v->depth; i++)
        if (v->level[i].cells > 0xffffffffu) return VOLA_E_SIZE;
    for (i = 0; i + 1 < v->depth; i++) {
        vola_level *level = &v->level[i];
        uint32_t before = 0;
        size_t n;
        level->rank = memory;
        for (n = 0; n < level->count; n++) {
            if (n % VOLA_RANK_STRIDE == 0) *memory++ = before;
            before += vola__popcount(vola__word_at(v, i, n));
        }
    }
    return VOLA_OK;
}

static size_t vola__rank(const vola *v, int i, size_t number) {
    const vola_level *level = &v->level[i];
    size_t n = 0, before = 0;
    if (level->rank) {
        before = level->rank[number / VOLA_RANK_STRIDE];
        n = number - number % VOLA_RANK_STRIDE;
    }
    for (; n < number; n++) before += vola__popcount(vola__word_at(v, i, n));
    return before;
}

static int vola__has_cell(const vola *v, int level, int32_t x, int32_t y, int32_t z) {
    int32_t size;
    if (level < 1 || level > v->depth) return 0;
    size = (int32_t)1 << 2 * level;
    return x >= 0 && y >= 0 && z >= 0 && x < size && y < size && z < size;
}

/* 1 if a cell of a sparse file is set; the number of its block goes to *block. */
static int vola__find(const vola *v, int level, int32_t x, int32_t y, int32_t z, size_t *block) {
    int i;
    *block = 0;
    for (i = 0; i < level; i++) {
        int shift = 2 * (level - 1 - i);
        int bit = (x >> shift & 3) | (y >> shift & 3) << 2 | (z >> shift & 3) << 4;
        uint64_t word = vola__word_at(v, i, *block), flag = (uint64_t)1 << bit;
        if (!(word & flag)) return 0;
        if (i + 1 < level) *block = vola__rank(v, i, *block) + vola__popcount(word & (flag - 1));
    }
    return 1;
}

VOLA_DEF uint64_t vola_count(const vola *v, int level) {
    return level < 1 || level > v->depth ? 0 : v->level[level - 1].cells;
}

VOLA_DEF int vola_is_set(const vola *v, int level, int32_t x, int32_t y, int32_t z) {
    size_t block;
    if (!vola__has_cell(v, level, x, y, z)) return 0;
    if (v->mode == VOLA_DENSE) return vola__strip_bit(v, level - 1, x, y, z);
    return vola__find(v, level, x, y, z, &block);
}

VOLA_DEF int vola_contains(const vola *v, int32_t x, int32_t y, int32_t z) {
    return vola_is_set(v, v->depth, x, y, z);
}

VOLA_DEF uint64_t vola_word(const vola *v, int level, size_t number) {
    if (level < 1 || level > v->depth || number >= v->level[level - 1].count) return 0;
    return vola__word_at(v, level - 1, number);
}

VOLA_DEF uint64_t vola_metadata_word(const vola *v, int level, size_t number) {
    const vola_level *at;
    if (level < 1 || level > v->depth) return 0;
    at = &v->level[level - 1];
    if (number >= at->count || !at->metadata) return 0;
    return vola__u64(v->data + at->metadata + 8 * number);
}

static size_t vola__strip(int level, int32_t x, int32_t y, int32_t z) {
    uint64_t linear = (uint64_t)x | (uint64_t)y << 2 * level | (uint64_t)z << 4 * level;
    return (size_t)(linear >> 6);
}

VOLA_DEF int vola_metadata(const vola *v, int level, int32_t x, int32_t y, int32_t z,
                           uint64_t *word) {
    size_t number;
    if (!v->has_metadata || !vola__has_cell(v, level, x, y, z)) return 0;
    if (v->mode == VOLA_DENSE) {
        if (!vola__strip_bit(v, level - 1, x, y, z)) return 0;
        number = vola__strip(level, x, y, z);
    } else if (!vola__find(v, level, x, y, z, &number)) {
        return 0;
    }
    *word = vola_metadata_word(v, level, number);
    return 1;
}

/* ---------------------------------------------------------------------------------- the walk */

VOLA_DEF void vola_begin(vola_iter *it, const vola *v, int level) {
    memset(it, 0, sizeof *it);
    it->volume = v;
    it->level = level;
    if (level < 1 || level > v->depth) return;
    it->next[0] = 1;
    it->left[0] = vola__word_at(v, 0, 0); /* the root has one order only */
}

VOLA_DEF int vola_next(vola_iter *it) {
    const vola *v = it->volume;
    for (;;) {
        uint64_t *left = &it->left[it->at], low;
        int bit;
        if (!*left) {
            if (it->at == 0) return 0;
            it->at--;
            it->block_x >>= 2;
            it->block_y >>= 2;
            it->block_z >>= 2;
            continue;
        }
        low = *left & (~*left + 1);
        *left ^= low;
        bit = (int)vola__popcount(low - 1);
        it->x = 4 * it->block_x + (bit & 3);
        it->y = 4 * it->block_y + (bit >> 2 & 3);
        it->z = 4 * it->block_z + (bit >> 4);
        if (it->at + 1 == it->level) {
            it->block = it->next[it->at] - 1;
            return 1;
        }
        it->at++;
        it->block_x = it->x;
        it->block_y = it->y;
        it->block_z = it->z;
        if (v->mode == VOLA_DENSE)
            it->left[it->at] = vola__dense_block(v, it->at, it->x, it->y, it->z);
        else /* the j-th set bit of a level owns the j-th word of the next */
            it->left[it->at] = vola__word_at(v, it->at, it->next[it->at]++);
    }
}

VOLA_DEF int vola_iter_metadata(const vola_iter *it, uint64_t *word) {
    const vola *v = it->volume;
    size_t number = it->block;
    if (!v->has_metadata) return 0;
    if (v->mode == VOLA_DENSE) number = vola__strip(it->level, it->x, it->y, it->z);
    *word = vola_metadata_word(v, it->level, number);
    return 1;
}

/* ------------------------------------------------------------------------------- coordinates */

#ifndef VOLA_NO_DOUBLE
static double vola__cells(int level) { return (double)((int32_t)1 << 2 * level); }

VOLA_DEF double vola_edge(const vola *v, int level) { return v->side / vola__cells(level); }

/* The whole number next to a value of at least 0, halves to the even one. */
static int32_t vola__round(double value) {
    int32_t below = (int32_t)value;
    double part = value - below;
    return below + (part > 0.5 || (part == 0.5 && (below & 1)));
}

static int32_t vola__axis_cell(const vola *v, int level, double place, double corner) {
    double largest = vola__abs(place) > vola__abs(corner) ? vola__abs(place) : vola__abs(corner);
    double error = 4 * 2.220446049250313e-16 * largest, away = place - corner, cell;
    if (!(away >= -error && away <= v->side + error)) return -1; /* NaN too */
    if (v->side == 0 || (corner + v->side) - corner == 0) return 0;
    if (v->quantizer != VOLA_FLOOR) {
        double part = away / ((corner + v->side) - corner); /* as the toolkit, to the last bit */
        part = part < 0 ? 0 : part > 1 ? 1 : part;
        return vola__round(part * (vola__cells(v->depth) - 1)) >> 2 * (v->depth - level);
    }
    away += error;
    cell = (away < 0 ? 0 : away) * (vola__cells(level) / v->side);
    /* compared before the cast: a tiny side may make it infinite */
    return cell < vola__cells(level) - 1 ? (int32_t)cell : (int32_t)(vola__cells(level) - 1);
}

VOLA_DEF int vola_locate(const vola *v, int level, const double xyz[3], int32_t cell[3]) {
    int axis;
    if (level < 1 || level > v->depth) return 0;
    for (axis = 0; axis < 3; axis++) {
        double place = axis == 2 && v->z_ratio != 1 ? xyz[axis] * v->z_ratio : xyz[axis];
        cell[axis] = vola__axis_cell(v, level, place, v->corner[axis]);
        if (cell[axis] < 0) return 0;
    }
    return 1;
}

VOLA_DEF int vola_contains_point(const vola *v, const double xyz[3]) {
    int32_t cell[3];
    return vola_locate(v, v->depth, xyz, cell) && vola_contains(v, cell[0], cell[1], cell[2]);
}

VOLA_DEF void vola_centre(const vola *v, int level, const int32_t cell[3], double xyz[3]) {
    int axis;
    for (axis = 0; axis < 3; axis++) {
        double place = cell[axis], step;
        if (v->quantizer == VOLA_FLOOR) {
            place += 0.5;
            step = vola_edge(v, level);
        } else { /* the middle of the points that the cell's voxels were rounded to */
            double span = vola__cells(v->depth - level);
            place = place * span + (span - 1) / 2;
            step = v->side / (vola__cells(v->depth) - 1);
        }
        xyz[axis] = place * step + v->corner[axis];
    }
    xyz[2] /= v->z_ratio;
}
#endif

#ifdef __cplusplus
}
#endif
#endif /* VOLA_IMPLEMENTED */
#endif /* VOLA_IMPLEMENTATION */
