#include "handles.h"

#if defined(_MSC_VER)
#include <intrin.h>
#define LOCK_TAKE(lock) _InterlockedExchange(lock, 1)
#define LOCK_GIVE(lock) _InterlockedExchange(lock, 0)
#else
#define LOCK_TAKE(lock) __sync_lock_test_and_set(lock, 1)
#define LOCK_GIVE(lock) __sync_lock_release(lock)
#endif

HandleEntry handle_table[HANDLE_COUNT];

static HandleEntry *unused;     /* entries that have been given back */
static uintptr_t fresh;         /* entries from here on have never been used */
static volatile long lock;      /* hosts create and free instances from several threads */

static HandleEntry *take_entry(void)
{
    HandleEntry *entry = unused;
    if (entry) unused = entry->object;
    else if (fresh < HANDLE_COUNT) entry = &handle_table[fresh++];
    return entry;
}

static void *encode(const HandleEntry *entry)
{
    const uintptr_t id = (entry->generation << HANDLE_BITS) | (uintptr_t)(entry - handle_table);
    return (void *)((id * HANDLE_FACTOR) ^ HANDLE_SALT);
}

static void fill(HandleEntry *entry, void *object, unsigned kind)
{
    const uintptr_t uses = (entry->generation >> 2) + 1;
    entry->generation = (uses << (HANDLE_BITS + 2) >> HANDLE_BITS) | kind; /* what a handle can carry of it */
    entry->object = object;
}

void *handle_make(void *object, unsigned kind)
{
    void *handle = 0;
    while (LOCK_TAKE(&lock)) { }
    HandleEntry *entry = take_entry();
    while (entry && !handle) { /* one handle in 2^64 would look like NULL */
        fill(entry, object, kind);
        handle = encode(entry);
    }
    LOCK_GIVE(&lock);
    return handle;
}

void *handle_drop(void *handle, unsigned kind)
{
    while (LOCK_TAKE(&lock)) { }
    void *object = handle_find(handle, kind);
    if (object) {
        HandleEntry *entry = &handle_table[(((uintptr_t)handle ^ HANDLE_SALT) * HANDLE_INVERSE) & (HANDLE_COUNT - 1)];
        entry->generation &= ~(uintptr_t)3;
        entry->object = unused;
        unused = entry;
    }
    LOCK_GIVE(&lock);
    return object;
}
