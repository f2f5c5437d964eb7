/* Clocks that can be set for one process, preloaded into it (LD_PRELOAD); the system's clock is never touched.
 *
 * DELTAQ_CLOCKS names a folder. The process keeps a file there, called by its process id, and adds what stands in it to
 * what its clocks say; it begins as a copy of the file `begin`, and `clocks.py` writes both. Deadlines that go to the kernel as a time of day or of the monotonic
 * clock are turned back into the kernel's.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <linux/futex.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define SECOND INT64_C(1000000000)
#define LONGEST_UPTIME_S (INT64_C(10000) * 86400) /* a later second can only be one since 1970 */

/* Layout shared with clocks.py: how far each clock is ahead, and how much faster the wall clock runs since when. */
struct clocks {
    _Atomic int64_t wall_ns;
    _Atomic int64_t monotonic_ns;
    _Atomic int64_t wall_drift_ppm;
    _Atomic int64_t drifts_since_ns; /* on the kernel's monotonic clock */
};

static struct clocks *clocks;

_Noreturn static void give_up(const char *why, const char *what)
{
    dprintf(2, "error: DELTAQ_CLOCKS: %s %s\n", why, what);
    _exit(2);
}

/* The C library's own function of this name. */
#define REAL(name)                                                                                             \
    ({                                                                                                         \
        static __typeof__(&name) found;                                                                        \
        if (found == NULL)                                                                                     \
            found = (__typeof__(&name))real(#name);                                                            \
        found;                                                                                                 \
    })

static void *real(const char *name)
{
    void *found = dlsym(RTLD_NEXT, name);
    if (found == NULL)
        give_up("the C library has no", name);
    return found;
}

__attribute__((constructor)) static void begin(void)
{
    const char *folder = getenv("DELTAQ_CLOCKS");
    if (folder == NULL)
        give_up("there is no folder", "");
    char path[4096], of_this_process[sizeof(struct clocks)];
    snprintf(path, sizeof path, "%s/begin", folder);
    int file = open(path, O_RDONLY | O_CLOEXEC);
    if (file < 0 || read(file, of_this_process, sizeof of_this_process) != sizeof of_this_process)
        give_up("cannot read", path);
    close(file);
    snprintf(path, sizeof path, "%s/%d", folder, (int)getpid());
    file = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (file < 0 || write(file, of_this_process, sizeof of_this_process) != sizeof of_this_process)
        give_up("cannot write", path);
    void *shared = mmap(NULL, sizeof(struct clocks), PROT_READ, MAP_SHARED, file, 0);
    if (shared == MAP_FAILED)
        give_up("cannot map", path);
    close(file);
    clocks = shared;
}

static int64_t nanoseconds(const struct timespec *t)
{
    return (int64_t)t->tv_sec * SECOND + t->tv_nsec;
}

static struct timespec timespec_of(int64_t ns)
{
    if (ns < 0)
        ns = 0;
    return (struct timespec){.tv_sec = ns / SECOND, .tv_nsec = ns % SECOND};
}

/* How far a clock is ahead of the kernel's [ns]. */
static int64_t ahead(clockid_t clock)
{
    if (clocks == NULL) /* asked before main() by another constructor */
        return 0;
    switch (clock) {
    case CLOCK_REALTIME:
    case CLOCK_REALTIME_COARSE: {
        int64_t drift_ppm = clocks->wall_drift_ppm, ns = clocks->wall_ns;
        if (drift_ppm != 0) {
            struct timespec now;
            REAL(clock_gettime)(CLOCK_MONOTONIC, &now);
            ns += (nanoseconds(&now) - clocks->drifts_since_ns) / 1000 * drift_ppm / 1000;
        }
        return ns;
    }
    case CLOCK_MONOTONIC:
    case CLOCK_MONOTONIC_COARSE:
    case CLOCK_MONOTONIC_RAW:
    case CLOCK_BOOTTIME:
        return clocks->monotonic_ns;
    default:
        return 0;
    }
}

/* --- what a clock says ------------------------------------------------------------------------------------ */

int clock_gettime(clockid_t clock, struct timespec *t)
{
    int status = REAL(clock_gettime)(clock, t);
    if (status == 0)
        *t = timespec_of(nanoseconds(t) + ahead(clock));
    return status;
}

int gettimeofday(struct timeval *restrict t, void *restrict zone)
{
    (void)zone;
    struct timespec now;
    int status = clock_gettime(CLOCK_REALTIME, &now);
    if (status == 0)
        *t = (struct timeval){.tv_sec = now.tv_sec, .tv_usec = now.tv_nsec / 1000};
    return status;
}

time_t time(time_t *t)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (t != NULL)
        *t = now.tv_sec;
    return now.tv_sec;
}

/* --- until when somebody waits ---------------------------------------------------------------------------- */

static const struct timespec *of_kernel(clockid_t clock, const struct timespec *deadline, struct timespec *room)
{
    if (deadline == NULL)
        return NULL;
    *room = timespec_of(nanoseconds(deadline) - ahead(clock));
    return room;
}

int sem_clockwait(sem_t *restrict semaphore, clockid_t clock, const struct timespec *restrict deadline)
{
    struct timespec room;
    return REAL(sem_clockwait)(semaphore, clock, of_kernel(clock, deadline, &room));
}

int pthread_cond_clockwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex, clockid_t clock,
                           const struct timespec *restrict deadline)
{
    struct timespec room;
    return REAL(pthread_cond_clockwait)(condition, mutex, clock, of_kernel(clock, deadline, &room));
}

int pthread_cond_timedwait(pthread_cond_t *restrict condition, pthread_mutex_t *restrict mutex,
                           const struct timespec *restrict deadline)
{
    /* which clock a condition goes by cannot be asked, but is seen from the deadline */
    clockid_t clock = deadline->tv_sec > LONGEST_UPTIME_S ? CLOCK_REALTIME : CLOCK_MONOTONIC;
    struct timespec room;
    return REAL(pthread_cond_timedwait)(condition, mutex, of_kernel(clock, deadline, &room));
}

int clock_nanosleep(clockid_t clock, int flags, const struct timespec *until, struct timespec *left)
{
    struct timespec room;
    if (flags & TIMER_ABSTIME)
        until = of_kernel(clock, until, &room);
    return REAL(clock_nanosleep)(clock, flags, until, left);
}

long syscall(long number, ...)
{
    long a[6];
    va_list list;
    va_start(list, number);
    for (int i = 0; i < 6; i++)
        a[i] = va_arg(list, long);
    va_end(list);
    struct timespec room;
    if (number == SYS_clock_gettime)
        return clock_gettime((clockid_t)a[0], (struct timespec *)a[1]);
    if (number == SYS_futex && (a[1] & FUTEX_CMD_MASK) == FUTEX_WAIT_BITSET) {
        clockid_t clock = a[1] & FUTEX_CLOCK_REALTIME ? CLOCK_REALTIME : CLOCK_MONOTONIC;
        a[3] = (long)of_kernel(clock, (const struct timespec *)a[3], &room);
    }
    return REAL(syscall)(number, a[0], a[1], a[2], a[3], a[4], a[5]);
}
