/* The codes of docs/protocol.md on a small processor: AES-CMAC (RFC 4493) over tiny-AES-c, no allocation.

   tests/protocol/test_c_codes.py compiles this file with that library and holds it against the golden vectors. A line of
   input is what to compute and its fields, bytes in hexadecimal digits ("-" for none), numbers decimal; a line of output
   is the code, or the tag. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "aes.h"

#define BLOCK 16
#define DATA_MAX 4096

/* A key with its subkeys, prepared once for a session. */
struct cmac_key {
    struct AES_ctx aes;
    uint8_t first[BLOCK], second[BLOCK];
};

/* A code under way: bytes are taken as they come. */
struct cmac {
    const struct cmac_key *key;
    uint8_t state[BLOCK], last[BLOCK];
    size_t held; /* bytes of last */
};

static void doubled(uint8_t out[BLOCK], const uint8_t in[BLOCK]) {
    for (int i = 0; i < BLOCK; i++) out[i] = (uint8_t)(in[i] << 1 | (i + 1 < BLOCK ? in[i + 1] >> 7 : 0));
    out[BLOCK - 1] ^= (uint8_t)(0x87 * (in[0] >> 7));
}

static void cmac_prepare(struct cmac_key *key, const uint8_t bytes[BLOCK]) {
    uint8_t zero[BLOCK] = {0};
    AES_init_ctx(&key->aes, bytes);
    AES_ECB_encrypt(&key->aes, zero);
    doubled(key->first, zero);
    doubled(key->second, key->first);
}

static void cmac_begin(struct cmac *code, const struct cmac_key *key) {
    memset(code, 0, sizeof *code);
    code->key = key;
}

static void cmac_block(struct cmac *code) {
    for (int i = 0; i < BLOCK; i++) code->state[i] ^= code->last[i];
    AES_ECB_encrypt(&code->key->aes, code->state);
}

static void cmac_add(struct cmac *code, const void *data, size_t length) {
    const uint8_t *bytes = data;
    for (size_t i = 0; i < length; i++) {
        if (code->held == BLOCK) {
            cmac_block(code);
            code->held = 0;
        }
        code->last[code->held++] = bytes[i];
    }
}

static void cmac_end(struct cmac *code, uint8_t out[BLOCK]) {
    const uint8_t *subkey = code->key->first;
    if (code->held < BLOCK) {
        subkey = code->key->second;
        memset(code->last + code->held, 0, BLOCK - code->held);
        code->last[code->held] = 0x80;
    }
    for (int i = 0; i < BLOCK; i++) code->last[i] ^= subkey[i];
    cmac_block(code);
    memcpy(out, code->state, BLOCK);
}

static void add_u32(struct cmac *code, uint32_t value) {
    const uint8_t bytes[4] = {(uint8_t)value, (uint8_t)(value >> 8), (uint8_t)(value >> 16), (uint8_t)(value >> 24)};
    cmac_add(code, bytes, sizeof bytes);
}

/* First 16 bits over counter, echo and the last two bytes of the heartbeat. */
static uint32_t heartbeat_tag(const struct cmac_key *key, uint32_t counter, uint32_t echo, const uint8_t last[2]) {
    struct cmac code;
    uint8_t out[BLOCK];
    cmac_begin(&code, key);
    add_u32(&code, counter);
    add_u32(&code, echo);
    cmac_add(&code, last, 2);
    cmac_end(&code, out);
    return out[0] | (uint32_t)out[1] << 8;
}

/* First 20 bits over the counter and the five joints in counts. */
static uint32_t sample_tag(const struct cmac_key *key, uint32_t counter, const int32_t joints[5]) {
    struct cmac code;
    uint8_t out[BLOCK];
    cmac_begin(&code, key);
    add_u32(&code, counter);
    for (int i = 0; i < 5; i++) add_u32(&code, (uint32_t)joints[i]);
    cmac_end(&code, out);
    return out[0] | (uint32_t)out[1] << 8 | (uint32_t)(out[2] & 0x0F) << 16;
}

/* Of a record in a session: domain | 0 | session digest | sequence | body without its code. */
static void record_code(const struct cmac_key *key, const char *domain, const uint8_t digest[32], uint32_t sequence,
                        const uint8_t *body, size_t length, uint8_t out[BLOCK]) {
    struct cmac code;
    cmac_begin(&code, key);
    cmac_add(&code, domain, strlen(domain) + 1);
    cmac_add(&code, digest, 32);
    add_u32(&code, sequence);
    cmac_add(&code, body, length);
    cmac_end(&code, out);
}

/* Of OPEN, which has neither session nor sequence yet. */
static void open_code(const struct cmac_key *key, const uint8_t *body, size_t length, uint8_t out[BLOCK]) {
    static const char domain[] = "cutgate/open/1";
    struct cmac code;
    cmac_begin(&code, key);
    cmac_add(&code, domain, sizeof domain);
    cmac_add(&code, body, length);
    cmac_end(&code, out);
}

/* ---------------------------------------------------------------- reading and writing, for the test alone */

static size_t read_bytes(uint8_t *out) {
    static char text[2 * DATA_MAX + 2];
    size_t length = 0;
    if (scanf("%8193s", text) != 1) exit(2);
    if (strcmp(text, "-") == 0) return 0;
    for (; text[2 * length] != 0; length++) {
        unsigned byte;
        if (length == DATA_MAX || sscanf(text + 2 * length, "%2x", &byte) != 1) exit(2);
        out[length] = (uint8_t)byte;
    }
    return length;
}

static long long read_number(void) {
    long long value;
    if (scanf("%lld", &value) != 1) exit(2);
    return value;
}

static void write_code(const uint8_t code[BLOCK]) {
    for (int i = 0; i < BLOCK; i++) printf("%02x", code[i]);
    printf("\n");
}

int main(void) {
    static uint8_t data[DATA_MAX];
    char what[16];
    while (scanf("%15s", what) == 1) {
        struct cmac_key key;
        uint8_t bytes[DATA_MAX], out[BLOCK];
        if (read_bytes(bytes) != BLOCK) return 2;
        cmac_prepare(&key, bytes);
        if (strcmp(what, "bytes") == 0) {
            struct cmac code;
            size_t length = read_bytes(data);
            cmac_begin(&code, &key);
            cmac_add(&code, data, length);
            cmac_end(&code, out);
            write_code(out);
        } else if (strcmp(what, "heartbeat") == 0) {
            uint32_t counter = (uint32_t)read_number(), echo = (uint32_t)read_number();
            if (read_bytes(data) != 2) return 2;
            printf("%lu\n", (unsigned long)heartbeat_tag(&key, counter, echo, data));
        } else if (strcmp(what, "sample") == 0) {
            uint32_t counter = (uint32_t)read_number();
            int32_t joints[5];
            for (int i = 0; i < 5; i++) joints[i] = (int32_t)read_number();
            printf("%lu\n", (unsigned long)sample_tag(&key, counter, joints));
        } else if (strcmp(what, "open") == 0) {
            size_t length = read_bytes(data);
            open_code(&key, data, length, out);
            write_code(out);
        } else if (strcmp(what, "record") == 0) {
            char domain[32];
            uint8_t digest[DATA_MAX];
            uint32_t sequence;
            size_t length;
            if (scanf("%31s", domain) != 1 || read_bytes(digest) != 32) return 2;
            sequence = (uint32_t)read_number();
            length = read_bytes(data);
            record_code(&key, domain, digest, sequence, data, length, out);
            write_code(out);
        } else {
            return 2;
        }
    }
    return 0;
}
