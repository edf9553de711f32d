/* Kills the process at one of its changes of files: loaded before the C library (LD_PRELOAD), in whose place it is called.
   A write is done by half before that. Calls on the standard streams and of child processes do not count. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

static long seen, fatal = -1;

void crash_arm(long number) {
    seen = 0;
    fatal = number;
}

long crash_seen(void) { return seen; }

static int now(void) { return seen++ == fatal; }

static void end(void) {
    kill(getpid(), SIGKILL);
    for (;;) pause();
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define REPLACED(result, name, declared, given) \
    result name declared {                       \
        if (now()) end();                        \
        return NEXT(name) given;                 \
    }

REPLACED(int, rename, (const char *from, const char *to), (from, to))
REPLACED(int, renameat, (int a, const char *from, int b, const char *to), (a, from, b, to))
REPLACED(int, unlink, (const char *path), (path))
REPLACED(int, unlinkat, (int folder, const char *path, int flags), (folder, path, flags))
REPLACED(int, rmdir, (const char *path), (path))
REPLACED(int, mkdir, (const char *path, mode_t mode), (path, mode))
REPLACED(int, mkdirat, (int folder, const char *path, mode_t mode), (folder, path, mode))
REPLACED(int, fsync, (int file), (file))
REPLACED(int, ftruncate64, (int file, off64_t size), (file, size))
REPLACED(ssize_t, sendfile64, (int out, int in, off64_t *offset, size_t size), (out, in, offset, size))

ssize_t write(int file, const void *data, size_t size) {
    if (file > 2 && now()) {
        NEXT(write)(file, data, size / 2);
        end();
    }
    return NEXT(write)(file, data, size);
}

#define OPENED(name)                                   \
    int name(const char *path, int flags, ...) {       \
        va_list rest;                                  \
        va_start(rest, flags);                         \
        mode_t mode = va_arg(rest, mode_t);            \
        va_end(rest);                                  \
        if (flags & O_CREAT && now()) end();           \
        return NEXT(name)(path, flags, mode);          \
    }

OPENED(open)
OPENED(open64)
