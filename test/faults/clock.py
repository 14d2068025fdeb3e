"""A wall clock that can be set for the nodes alone: a small library that their processes load before any other.

Setting the machine's own clock would disturb everybody on it. The library is compiled when it is needed.
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
from pathlib import Path

__all__ = ["SteppedClock", "compiler"]

FILE = "KR270_MILLING_CLOCK"
SOURCE = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile const long long *offset_ns;

__attribute__((constructor)) static void begin(void) {
    const char *name = getenv("KR270_MILLING_CLOCK");
    int file = name ? open(name, O_RDONLY) : -1;
    if (file < 0) return;
    void *page = mmap(0, 8, PROT_READ, MAP_SHARED, file, 0);
    if (page != MAP_FAILED) offset_ns = page;
    close(file);
}
static void shift(struct timespec *t, long long by) {
    long long ns = t->tv_nsec + by % 1000000000LL;
    t->tv_sec += by / 1000000000LL;
    if (ns >= 1000000000LL) { ns -= 1000000000LL; t->tv_sec++; }
    if (ns < 0) { ns += 1000000000LL; t->tv_sec--; }
    t->tv_nsec = ns;
}
static long long offset(void) { return offset_ns ? *offset_ns : 0; }

int clock_gettime(clockid_t which, struct timespec *t) {
    static int (*next)(clockid_t, struct timespec *);
    if (!next) next = dlsym(RTLD_NEXT, "clock_gettime");
    int code = next(which, t);
    if (!code && (which == CLOCK_REALTIME || which == CLOCK_REALTIME_COARSE)) shift(t, offset());
    return code;
}
int gettimeofday(struct timeval *restrict v, void *restrict zone) {
    struct timespec t;
    (void)zone;
    int code = clock_gettime(CLOCK_REALTIME, &t);
    v->tv_sec = t.tv_sec;
    v->tv_usec = t.tv_nsec / 1000;
    return code;
}
time_t time(time_t *out) {
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    if (out) *out = t.tv_sec;
    return t.tv_sec;
}
/* deadlines of the wall clock, as the kernel knows it; those of the monotonic clock are small numbers */
static const struct timespec *deadline(const struct timespec *t, struct timespec *own) {
    *own = *t;
    if (t->tv_sec > 1000000000) shift(own, -offset());
    return own;
}
int pthread_cond_timedwait(pthread_cond_t *restrict c, pthread_mutex_t *restrict m, const struct timespec *restrict t) {
    static int (*next)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
    struct timespec own;
    if (!next) next = dlvsym(RTLD_NEXT, "pthread_cond_timedwait", "GLIBC_2.3.2");
    if (!next) next = dlsym(RTLD_NEXT, "pthread_cond_timedwait");
    return next(c, m, deadline(t, &own));
}
int pthread_mutex_timedlock(pthread_mutex_t *restrict m, const struct timespec *restrict t) {
    static int (*next)(pthread_mutex_t *, const struct timespec *);
    struct timespec own;
    if (!next) next = dlsym(RTLD_NEXT, "pthread_mutex_timedlock");
    return next(m, deadline(t, &own));
}
int sem_timedwait(sem_t *restrict s, const struct timespec *restrict t) {
    static int (*next)(sem_t *, const struct timespec *);
    struct timespec own;
    if (!next) next = dlsym(RTLD_NEXT, "sem_timedwait");
    return next(s, deadline(t, &own));
}
"""


def compiler() -> str | None:
    """A C compiler, where there is one."""
    return next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)


class SteppedClock:
    """Context manager: processes started within it see the wall clock plus an offset that may be set at any time."""

    def __init__(self, directory: Path):
        self._library, self._file = directory / "clock.so", directory / "clock"
        source = directory / "clock.c"
        source.write_text(SOURCE, encoding="utf-8")
        command = [compiler(), "-shared", "-fPIC", "-O1", "-w", "-o", str(self._library), str(source), "-ldl"]
        subprocess.run(command, check=True, timeout=60)
        self.set(0.0)

    def set(self, offset: float) -> None:
        """[s]"""
        with open(self._file, "r+b" if self._file.exists() else "wb") as stream:
            stream.write(struct.pack("=q", round(offset * 1e9)))

    def __enter__(self) -> SteppedClock:
        self._before = os.environ.get("LD_PRELOAD")
        os.environ["LD_PRELOAD"] = " ".join(filter(None, [str(self._library), self._before]))
        os.environ[FILE] = str(self._file)
        return self

    def __exit__(self, *_) -> None:
        del os.environ[FILE], os.environ["LD_PRELOAD"]
        if self._before is not None:
            os.environ["LD_PRELOAD"] = self._before
