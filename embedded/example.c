/*
 * Ask a VOLA file from C: what is in it, and is there something at X Y Z?
 *
 *     cc -std=c99 -O2 -o example example.c
 *     gunzip -k tile.vol.gz && ./example tile.vol 523500 5398300 310
 *
 * On a device the file would lie in flash, and `rank` be an array of a fixed size.
 */
#include <stdio.h>
#include <stdlib.h>

#define VOLA_IMPLEMENTATION
#include "vola.h"

static unsigned char *read_file(const char *name, size_t *size) {
    FILE *file = fopen(name, "rb");
    unsigned char *data = NULL;
    long length;
    if (!file) return NULL;
    if (fseek(file, 0, SEEK_END) == 0 && (length = ftell(file)) >= 0) {
        *size = (size_t)length;
        data = (unsigned char *)malloc(*size + 1);
        rewind(file);
        if (data && fread(data, 1, *size, file) != *size) {
            free(data);
            data = NULL;
        }
    }
    fclose(file);
    return data;
}

int main(int argc, char **argv) {
    vola volume;
    vola_status status;
    uint32_t *rank;
    const char *crs, *name;
    size_t size, n;
    unsigned char *data;
    int level, found = 0;

    if (argc != 2 && argc != 5) {
        fprintf(stderr, "usage: %s FILE.vol [X Y Z]\n", argv[0]);
        return 2;
    }
    data = read_file(argv[1], &size);
    if (!data) {
        fprintf(stderr, "%s: can't be read\n", argv[1]);
        return 4;
    }
    status = vola_open(&volume, data, size, VOLA_CHECK_ALL);
    if (status != VOLA_OK) {
        fprintf(stderr, "%s: %s: %s (offset %lu)\n", vola_code(status), argv[1],
                status == VOLA_E_NOT_VOLA ? "not a VOLA file; gunzip it first?" : "damaged",
                (unsigned long)volume.fault);
        free(data);
        return 6;
    }
    n = vola_rank_size(&volume);
    rank = (uint32_t *)malloc(n * sizeof *rank + 1);
    if (rank) vola_build_rank(&volume, rank, n); /* without it look-ups are slower, not wrong */

    printf("%s, depth %d, cube %.10g %.10g %.10g side %.10g\n",
           volume.mode == VOLA_DENSE ? "dense" : "sparse", volume.depth, volume.corner[0],
           volume.corner[1], volume.corner[2], volume.side);
    if (vola_member(volume.json, volume.json_size, "crs", &crs, &n) &&
        vola_member(crs, n, "horizontal", &name, &n))
        printf("CRS %.*s\n", (int)n, name);
    for (level = 1; level <= volume.depth; level++)
        printf("level %d: %lu cells of %g\n", level, (unsigned long)vola_count(&volume, level),
               vola_edge(&volume, level));
    if (argc == 5) {
        double point[3];
        int32_t cell[3];
        uint64_t word;
        for (level = 0; level < 3; level++) point[level] = strtod(argv[2 + level], NULL);
        found = vola_contains_point(&volume, point);
        printf("%s\n", found ? "occupied" : "empty");
        if (found && vola_locate(&volume, volume.depth, point, cell) &&
            vola_metadata(&volume, volume.depth, cell[0], cell[1], cell[2], &word))
            printf("red %d green %d blue %d class %d\n", (int)(word & 255), (int)(word >> 8 & 255),
                   (int)(word >> 16 & 255), (int)(word >> 48 & 255));
    }
    free(rank);
    free(data);
    return 0;
}
