/* Coded poses (docs/protocol.md) on a small processor: no allocation, no floating point, words of 32 bits alone.

   tests/protocol/test_c_coding.py compiles this file and holds it against the golden vectors and against changed ones. A
   line of input is a number of poses and bytes in hexadecimal digits ("-" for none); a line of output is the poses, 20
   bytes each, or "refused". */

#include <stdint.h>
#include <stdio.h>
#include <string.h>

#define COMPONENTS 5
#define POSES_MAX 200
#define DATA_MAX 4006
#define ORDERS 8
#define PREFIXED 33 /* the least parameter of numbers of differing length */
#define KNOWN_BITS 31

/* The bytes of a block; a reader that has gone beyond them says so at its end. */
struct reader {
    const uint8_t *data;
    uint32_t bits, at;
};

static uint32_t take(struct reader *from, unsigned width) {
    uint32_t value = 0;
    for (unsigned i = 0; i < width; i++, from->at++)
        if (from->at < from->bits) value |= (uint32_t)(from->data[from->at >> 3] >> (from->at & 7) & 1) << i;
    return value;
}

static unsigned zeros_before_one(struct reader *from, unsigned most) {
    unsigned zeros = 0;
    while (zeros <= most && take(from, 1) == 0) zeros++;
    return zeros;
}

static unsigned bit_length(uint32_t number) {
    unsigned length = 0;
    for (; number != 0; number >>= 1) length++; /* 32 - clz on most processors */
    return length;
}

static uint32_t number_of(uint32_t difference) {
    return difference << 1 ^ (uint32_t) - (difference >> 31);
}

/* One component into every fifth word of poses. Returns order - 1 | parameter << 3, or -1. */
static int read_component(struct reader *from, uint32_t *poses, unsigned count) {
    uint32_t differences[ORDERS + 1] = {0};
    unsigned order = take(from, 3) + 1, parameter = take(from, 6);
    int prefixed = parameter >= PREFIXED;
    unsigned known = prefixed ? parameter - PREFIXED : parameter;
    differences[0] = poses[0] = take(from, 32);
    for (unsigned i = 1; prefixed && i < count; i++) {
        unsigned zeros = zeros_before_one(from, 32 - known);
        if (zeros > 32 - known) return -1;
        poses[COMPONENTS * i] = zeros; /* kept where its value will stand */
    }
    for (unsigned i = 1; i < count; i++) {
        unsigned zeros = prefixed ? poses[COMPONENTS * i] : 0, top = i < order ? i : order;
        uint32_t number = take(from, zeros ? known + zeros - 1 : known);
        if (zeros) number |= (uint32_t)1 << (known + zeros - 1);
        differences[top] = number >> 1 ^ (uint32_t) - (number & 1);
        while (top-- > 0) differences[top] += differences[top + 1];
        poses[COMPONENTS * i] = differences[0];
    }
    return (int)((order - 1) | parameter << 3);
}

/* Order - 1 and parameter of the fewest bits, the lowest among equals. */
static int fewest(const uint32_t *poses, unsigned count) {
    uint32_t differences[ORDERS] = {0}, least = UINT32_MAX;
    static uint32_t lengths[ORDERS][33];
    int found = 0;
    memset(lengths, 0, sizeof lengths);
    for (unsigned i = 1; i < count; i++) {
        uint32_t difference = poses[COMPONENTS * i] - poses[COMPONENTS * (i - 1)];
        for (unsigned order = 0; order < ORDERS; order++) {
            lengths[order][bit_length(number_of(difference))]++;
            uint32_t before = differences[order];
            differences[order] = difference;
            if (i > order + 1) difference -= before; /* else no more differences lie before it */
        }
    }
    for (unsigned order = 0; order < ORDERS; order++) {
        unsigned longest = 32;
        while (longest > 0 && lengths[order][longest] == 0) longest--;
        for (unsigned option = 0; option <= KNOWN_BITS; option++) { /* fixed bits, then each k */
            uint32_t cost = option == 0 ? (count - 1) * longest : 0;
            for (unsigned b = 0; option > 0 && b <= 32; b++)
                cost += lengths[order][b] * (b < option ? option : 2 * b + 1 - option);
            if (cost < least) {
                least = cost;
                found = (int)(order | (option == 0 ? longest : PREFIXED + option - 1) << 3);
            }
        }
    }
    return found;
}

/* The poses of a block, count of them as its place says; 0 where they are refused. Work is bounded by count alone. */
static int read_poses(const uint8_t *data, uint32_t length, uint32_t *poses, unsigned count) {
    struct reader from = {data, 8 * length, 0};
    int chosen[COMPONENTS];
    for (unsigned i = 0; i < COMPONENTS; i++) {
        chosen[i] = read_component(&from, poses + i, count);
        if (chosen[i] < 0 || from.at > from.bits) return 0;
    }
    if (from.bits - from.at > 7 || take(&from, from.bits - from.at) != 0) return 0;
    for (unsigned i = 0; i < COMPONENTS; i++)
        if (chosen[i] != fewest(poses + i, count)) return 0;
    return 1;
}

/* ---------------------------------------------------------------- reading and writing, for the test alone */

int main(void) {
    static char text[2 * DATA_MAX + 2];
    static uint8_t data[DATA_MAX];
    static uint32_t poses[COMPONENTS * POSES_MAX];
    unsigned count;
    while (scanf("%u %8013s", &count, text) == 2) {
        uint32_t length = 0;
        if (count < 1 || count > POSES_MAX) return 2;
        for (; text[0] != '-' && text[2 * length] != 0; length++) {
            unsigned byte;
            if (sscanf(text + 2 * length, "%2x", &byte) != 1) return 2;
            data[length] = (uint8_t)byte;
        }
        if (!read_poses(data, length, poses, count)) {
            printf("refused\n");
            continue;
        }
        for (unsigned i = 0; i < COMPONENTS * count; i++)
            for (unsigned byte = 0; byte < 4; byte++) printf("%02x", (unsigned)(poses[i] >> 8 * byte & 0xFF));
        printf("\n");
    }
    return 0;
}
