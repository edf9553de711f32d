/* Opaque handles: what the host holds is a number, never an address, and it is looked up, never followed.
 * A stale, foreign, invented or NULL handle is therefore found out instead of crashing. */
#ifndef BRISTLE_HANDLES_H
#define BRISTLE_HANDLES_H

#include <stdint.h>

#include "interface.h" /* generated: TOKEN_SALT */

#define HANDLE_BITS 18 /* so many live handles at most; pages of the table that are never used take no memory */
#define HANDLE_COUNT ((uintptr_t)1 << HANDLE_BITS)

enum { HANDLE_INSTANCE = 1, HANDLE_STATE = 3 }; /* the lowest two bits of a generation; 0 and 2 are not alive */

typedef struct {
    void *object;          /* while free: the next free entry */
    uintptr_t generation;  /* counts the uses of the entry, times 4, plus what kind of object lives in it */
} HandleEntry;

extern HandleEntry handle_table[HANDLE_COUNT];

/* An odd factor and its inverse modulo 2^64 (and so modulo 2^32): they spread the bits of slot and generation. */
#define HANDLE_FACTOR ((uintptr_t)0x9E3779B97F4A7C15u)
#define HANDLE_INVERSE ((uintptr_t)0xF1DE83E19937733Du)
/* Another library, or the same one loaded elsewhere, has other handles. */
#define HANDLE_SALT ((uintptr_t)TOKEN_SALT ^ (uintptr_t)handle_table)

/* The object behind a handle of this kind, or 0. */
static inline void *handle_find(void *handle, unsigned kind)
{
    const uintptr_t id = ((uintptr_t)handle ^ HANDLE_SALT) * HANDLE_INVERSE;
    const HandleEntry *entry = &handle_table[id & (HANDLE_COUNT - 1)];
    return entry->generation == id >> HANDLE_BITS && (entry->generation & 3u) == kind ? entry->object : 0;
}

void *handle_make(void *object, unsigned kind); /* 0 if the table is full */
void *handle_drop(void *handle, unsigned kind); /* the object, whose handle is now stale; 0 if there is none */

#endif
