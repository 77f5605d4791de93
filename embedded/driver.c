/*
 * The test driver of vola.h (tests/test_embedded.py): files come on stdin, each as its length
 * (u32, little-endian) and its bytes, answers go to stdout.
 *
 *     driver dump      one JSON object a line: all that is in the file
 *     driver exercise  one code a line, after every function was called on the file and the answers
 *                      were held against each other; files with wrong checksums are gone through too
 *     driver voxels    binary, per file: u32 status, u64 n, then n times x, y, z (i32), word (u64)
 *     driver points    file, then rows of x, y, z (f64): per point i32 x, y, z or -1, i32 contained
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define VOLA_IMPLEMENTATION
#include "vola.h"

#define CHECK(claim) ((claim) ? (void)0 : fail(#claim, __LINE__))

static void fail(const char *claim, int line) {
    fprintf(stderr, "driver.c:%d: not true: %s\n", line, claim);
    abort();
}

/* The next file, in a block that ends where it ends and begins at an odd address. */
static unsigned char *next_file(size_t *size) {
    unsigned char head[4], *block;
    if (fread(head, 1, 4, stdin) != 4) return NULL;
    *size = vola__u32(head);
    block = (unsigned char *)malloc(*size + 1);
    CHECK(block != NULL);
    CHECK(fread(block + 1, 1, *size, stdin) == *size);
    return block;
}

/* ---------------------------------------------------------------------------------------- dump */

#ifndef VOLA_NO_DOUBLE

static void print_words(const vola *v, int level, const char *name, int metadata) {
    size_t i, count = v->level[level - 1].count;
    int first = 1;
    printf("\"%s\": {", name);
    for (i = 0; i < count; i++) {
        uint64_t word = metadata ? vola_metadata_word(v, level, i) : vola_word(v, level, i);
        if (v->mode == VOLA_DENSE && !word) continue;
        printf("%s\"%lu\": \"%08lx%08lx\"", first ? "" : ", ", (unsigned long)i,
               (unsigned long)(word >> 32), (unsigned long)(word & 0xffffffffu));
        first = 0;
    }
    printf("}");
}

static void dump(const unsigned char *data, size_t size) {
    vola v;
    vola_iter it;
    vola_status status = vola_open(&v, data, size, VOLA_CHECK_ALL);
    int level, i, first = 1;
    if (status != VOLA_OK) {
        printf("{\"status\": \"%s\", \"fault\": %lu}\n", vola_code(status), (unsigned long)v.fault);
        return;
    }
    printf("{\"status\": \"OK\", \"mode\": %d, \"depth\": %d, \"nbits\": %d, \"crs\": %lu, "
           "\"quantizer\": %d, \"warnings\": %d, \"lat\": %.17g, \"lon\": %.17g, "
           "\"z_ratio\": %.17g, \"side\": %.17g, \"corner\": [%.17g, %.17g, %.17g], \"box\": [",
           v.mode, v.depth, v.has_metadata, (unsigned long)v.crs, v.quantizer, v.warnings, v.lat,
           v.lon, v.z_ratio, v.side, v.corner[0], v.corner[1], v.corner[2]);
    for (i = 0; i < 6; i++) printf("%s%.17g", i ? ", " : "", v.box[i]);
    printf("], \"trailer\": ");
    if (v.json) fwrite(v.json, 1, v.json_size, stdout);
    else printf("null");
    printf(", \"levels\": [");
    for (level = 1; level <= v.depth; level++) {
        printf("%s{\"count\": %lu, \"cells\": %lu, ", level > 1 ? ", " : "",
               (unsigned long)v.level[level - 1].count, (unsigned long)vola_count(&v, level));
        print_words(&v, level, "words", 0);
        printf(", ");
        print_words(&v, level, "metadata", 1);
        printf("}");
    }
    printf("], \"voxels\": [");
    vola_begin(&it, &v, v.depth);
    while (vola_next(&it)) {
        uint64_t word = 0;
        int32_t cell[3];
        double place[3];
        int has = vola_iter_metadata(&it, &word);
        cell[0] = it.x;
        cell[1] = it.y;
        cell[2] = it.z;
        vola_centre(&v, v.depth, cell, place);
        printf("%s[%ld, %ld, %ld, ", first ? "" : ", ", (long)it.x, (long)it.y, (long)it.z);
        if (has) printf("\"%08lx%08lx\"", (unsigned long)(word >> 32), (unsigned long)(word & 0xffffffffu));
        else printf("null");
        printf(", %.17g, %.17g, %.17g]", place[0], place[1], place[2]);
        first = 0;
    }
    printf("]}\n");
}

#endif

/* ------------------------------------------------------------------------------------ exercise */

static uint32_t chance_state;

static uint32_t chance(void) { /* xorshift */
    chance_state ^= chance_state << 13;
    chance_state ^= chance_state >> 17;
    chance_state ^= chance_state << 5;
    return chance_state;
}

static void check_level(const vola *v, const vola *ranked, int level) {
    vola_iter it;
    uint64_t n = 0, limit = 3000;
    int32_t last = -1;
    vola_begin(&it, v, level);
    while (n < limit && vola_next(&it)) {
        uint64_t a = 0, b = 0, c = 0;
        int has = vola_iter_metadata(&it, &a);
        n++;
        if (n > 200 && n % 17) continue; /* the slow path is slow */
        CHECK(vola_is_set(v, level, it.x, it.y, it.z));
        CHECK(vola_is_set(ranked, level, it.x, it.y, it.z));
        CHECK(vola_metadata(v, level, it.x, it.y, it.z, &b) == has && a == b);
        CHECK(vola_metadata(ranked, level, it.x, it.y, it.z, &c) == has && a == c);
        if (level > 1) CHECK(vola_is_set(ranked, level - 1, it.x >> 2, it.y >> 2, it.z >> 2));
#ifndef VOLA_NO_DOUBLE
        {
            int32_t cell[3], found[3];
            double place[3];
            cell[0] = it.x;
            cell[1] = it.y;
            cell[2] = it.z;
            vola_centre(v, level, cell, place);
            if (vola_locate(v, level, place, found)) CHECK(found[0] >= 0 && found[2] >= 0);
        }
#endif
        CHECK(it.x != last || it.y || it.z || n == 1); /* the walk moves on */
        last = it.x;
    }
    CHECK(n == limit || n == vola_count(v, level) || v->warnings & VOLA_W_EMPTY_BLOCKS);
    CHECK(n <= vola_count(v, level));
}

#ifndef VOLA_NO_DOUBLE
static void check_point(const vola *v) {
    static const double odd[4] = {0.0, -1e308, 1e308, 0.0};
    double point[3];
    int32_t cell[3];
    int level;
    point[0] = v->corner[0] + v->side * (chance() % 1025) / 1024.0;
    point[1] = v->corner[1] + v->side * (chance() % 1025) / 1024.0;
    point[2] = (v->corner[2] + v->side * (chance() % 1025) / 1024.0) / v->z_ratio;
    if (chance() % 8 == 0) point[chance() % 3] = odd[chance() % 4] / odd[(chance() & 1) * 2];
    (void)vola_contains_point(v, point);
    for (level = 1; level <= v->depth; level++)
        if (vola_locate(v, level, point, cell))
            CHECK(cell[0] >= 0 && cell[0] < (int32_t)1 << 2 * level);
}
#endif

static void check_volume(vola *v) {
    size_t n = vola_rank_size(v), i;
    uint32_t *memory = (uint32_t *)malloc(n * sizeof *memory + 1);
    vola ranked = *v;
    uint64_t word;
    const char *value;
    int level;
    CHECK(memory != NULL);
    if (n) CHECK(vola_build_rank(&ranked, memory, n - 1) == VOLA_E_OPTION);
    CHECK(vola_build_rank(&ranked, memory, n) == VOLA_OK);
    for (level = 1; level <= v->depth; level++) check_level(v, &ranked, level);
    for (i = 0; i < 64; i++) {
        int32_t mask = (int32_t)(((uint32_t)1 << 2 * v->depth) - 1);
        int32_t x = (int32_t)(chance() & 0x7fffffff) & mask;
        int32_t y = (int32_t)(chance() & 0x7fffffff) & mask;
        int32_t z = (int32_t)(chance() & 0x7fffffff) & mask;
        CHECK(vola_contains(v, x, y, z) == vola_contains(&ranked, x, y, z));
#ifndef VOLA_NO_DOUBLE
        check_point(&ranked);
#endif
    }
    CHECK(!vola_is_set(v, v->depth, -1, 0, 0) && !vola_is_set(v, 0, 0, 0, 0));
    CHECK(!vola_is_set(v, v->depth + 1, 0, 0, 0) && !vola_count(v, v->depth + 1));
    CHECK(!vola_is_set(v, 1, 4, 0, 0) && !vola_metadata(v, 1, 0, 0, 4, &word));
    CHECK(!vola_word(v, 1, 1) && !vola_metadata_word(v, 1, 1));
    (void)vola_member(v->json, v->json_size, "no such key", &value, &i);
    free(memory);
}

static void exercise(const unsigned char *data, size_t size) {
    vola v;
    vola_status status = vola_open(&v, data, size, VOLA_CHECK_ALL);
    chance_state = 2463534242u + (uint32_t)size;
    puts(vola_code(status));
    if (status == VOLA_OK) check_volume(&v);
    else CHECK(v.fault <= size);
    if (status == VOLA_E_CORRUPT && vola_open(&v, data, size, VOLA_SKIP_CHECKSUMS) == VOLA_OK)
        check_volume(&v);
}

/* ------------------------------------------------------------------------------ voxels, points */

static void put(const void *bytes, size_t size) { CHECK(fwrite(bytes, 1, size, stdout) == size); }

static void voxels(const unsigned char *data, size_t size) {
    vola v;
    vola_iter it;
    uint32_t status = vola_open(&v, data, size, VOLA_CHECK_ALL);
    uint64_t n = status == VOLA_OK ? vola_count(&v, v.depth) : 0;
    put(&status, 4);
    put(&n, 8);
    if (status != VOLA_OK) return;
    vola_begin(&it, &v, v.depth);
    while (vola_next(&it)) {
        uint64_t word = 0;
        int32_t cell[3];
        cell[0] = it.x;
        cell[1] = it.y;
        cell[2] = it.z;
        (void)vola_iter_metadata(&it, &word);
        put(cell, 12);
        put(&word, 8);
    }
}

#ifndef VOLA_NO_DOUBLE
static void points(const unsigned char *data, size_t size) {
    vola v;
    size_t rows, i;
    unsigned char *asked = next_file(&rows);
    uint32_t *memory;
    CHECK(asked != NULL);
    CHECK(vola_open(&v, data, size, VOLA_CHECK_ALL) == VOLA_OK);
    memory = (uint32_t *)malloc(vola_rank_size(&v) * sizeof *memory + 1);
    CHECK(memory && vola_build_rank(&v, memory, vola_rank_size(&v)) == VOLA_OK);
    for (i = 0; i + 24 <= rows; i += 24) {
        double xyz[3];
        int32_t answer[4];
        memcpy(xyz, asked + 1 + i, 24);
        if (!vola_locate(&v, v.depth, xyz, answer)) answer[0] = answer[1] = answer[2] = -1;
        answer[3] = vola_contains_point(&v, xyz);
        CHECK(answer[3] == vola_contains(&v, answer[0], answer[1], answer[2]));
        put(answer, 16);
    }
    free(memory);
    free(asked);
}
#endif

int main(int argc, char **argv) {
    unsigned char *block;
    size_t size;
    const char *mode = argc == 2 ? argv[1] : "";
    void (*work)(const unsigned char *, size_t) = NULL;
    if (strcmp(mode, "exercise") == 0) work = exercise;
    if (strcmp(mode, "voxels") == 0) work = voxels;
#ifndef VOLA_NO_DOUBLE
    if (strcmp(mode, "dump") == 0) work = dump;
    if (strcmp(mode, "points") == 0) work = points;
#endif
    if (!work) {
        fprintf(stderr, "usage: driver dump|exercise|voxels|points < framed files\n");
        return 2;
    }
    while ((block = next_file(&size)) != NULL) {
        work(block + 1, size);
        free(block);
    }
    return 0;
}
