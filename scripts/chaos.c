/* Makes the n-th call of a kind fail below one folder, and sets the clock: scripts/chaos.py.
 *
 * Loaded before the C library (LD_PRELOAD), it replaces these calls of Python and of every library.
 * It does nothing until chaos_arm was called, in the process that is to meet the fault.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/sendfile.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { OPEN, WRITE, FSYNC, RENAME, CLOSE, LOCK };
enum { KILL = -1, SHORT = -2 };

static char folder[4096];
static int armed = -1, fault;
static long wanted, clock_shift;
static long *counts; /* calls of each kind, in memory shared with the process that armed this one */

void chaos_arm(const char *below, int kind, long number, int error, long shift, long *shared) {
  snprintf(folder, sizeof folder, "%s", below);
  wanted = number, fault = error, clock_shift = shift, counts = shared, armed = kind;
}

static int is_below(const char *path) {
  size_t length = strlen(folder);
  return strncmp(path, folder, length) == 0 && (path[length] == '/' || path[length] == 0);
}

static int link_below(const char *link, const char *name) {
  char path[8192];
  int old = errno;
  ssize_t length = readlink(link, path, 4096);
  errno = old;
  if (length <= 0) return 0;
  snprintf(path + length, sizeof path - length, "%s%s", name ? "/" : "", name ? name : "");
  return is_below(path);
}

static int fd_below(int fd) {
  char link[64];
  if (armed < 0) return 0;
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  return link_below(link, NULL);
}

static int path_below(int at, const char *path) {
  char link[64];
  if (armed < 0 || path == NULL) return 0;
  if (path[0] == '/') return is_below(path);
  if (at == AT_FDCWD) return link_below("/proc/self/cwd", path);
  snprintf(link, sizeof link, "/proc/self/fd/%d", at);
  return link_below(link, path);
}

/* 0: go on; else what is to happen. A full disk stays full, and a folder without locks has none. */
static int due(int kind, int below) {
  if (!below) return 0;
  long now = __atomic_add_fetch(&counts[kind], 1, __ATOMIC_SEQ_CST);
  if (kind != armed) return 0;
  int stays = kind == LOCK || (kind == WRITE && fault == ENOSPC);
  return now == wanted || (now > wanted && stays) ? fault : 0;
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define MEET(kind, below, failed, call)                \
  int what = due(kind, below);                         \
  if (what > 0) { errno = what; return failed; }       \
  __typeof__(call) result = call;                      \
  if (what == KILL) kill(getpid(), SIGKILL);           \
  return result;

/* A file is closed in any case, as Linux does it. */
#define MEET_CLOSING(below, failed, call)              \
  int what = due(CLOSE, below);                        \
  __typeof__(call) result = call;                      \
  if (what == KILL) kill(getpid(), SIGKILL);           \
  if (what > 0) { errno = what; return failed; }       \
  return result;

#define MODE(flags)                                    \
  va_list rest;                                        \
  va_start(rest, flags);                               \
  mode_t mode = va_arg(rest, mode_t);                  \
  va_end(rest);

#define OPENING(name)                                                                  \
  int name(const char *path, int flags, ...) {                                         \
    MODE(flags)                                                                        \
    MEET(OPEN, path_below(AT_FDCWD, path), -1, REAL(name)(path, flags, mode))          \
  }
#define OPENING_AT(name)                                                               \
  int name(int at, const char *path, int flags, ...) {                                 \
    MODE(flags)                                                                        \
    MEET(OPEN, path_below(at, path), -1, REAL(name)(at, path, flags, mode))            \
  }
#define OPENING_FILE(name)                                                             \
  FILE *name(const char *path, const char *mode) {                                     \
    MEET(OPEN, path_below(AT_FDCWD, path), NULL, REAL(name)(path, mode))               \
  }
OPENING(open)
OPENING(open64)
OPENING_AT(openat)
OPENING_AT(openat64)
OPENING_FILE(fopen)
OPENING_FILE(fopen64)

#define CALL(kind, below, type, name, parameters, values) \
  type name parameters { MEET(kind, below, -1, REAL(name) values) }
CALL(WRITE, fd_below(fd), ssize_t, writev, (int fd, const struct iovec *data, int count), (fd, data, count))
CALL(WRITE, fd_below(fd), ssize_t, pwrite64, (int fd, const void *data, size_t count, off64_t at), (fd, data, count, at))
CALL(WRITE, fd_below(to), ssize_t, sendfile64, (int to, int from, off64_t *at, size_t count), (to, from, at, count))
CALL(FSYNC, fd_below(fd), int, fsync, (int fd), (fd))
CALL(FSYNC, fd_below(fd), int, fdatasync, (int fd), (fd))
CALL(RENAME, path_below(AT_FDCWD, to), int, rename, (const char *from, const char *to), (from, to))
CALL(RENAME, path_below(b, to), int, renameat, (int a, const char *from, int b, const char *to), (a, from, b, to))
CALL(LOCK, fd_below(fd), int, flock, (int fd, int operation), (fd, operation))

ssize_t write(int fd, const void *data, size_t count) {
  int what = due(WRITE, fd_below(fd));
  if (what > 0) { errno = what; return -1; }
  ssize_t done = REAL(write)(fd, data, what == SHORT && count > 1 ? count / 2 : count);
  if (what == KILL) kill(getpid(), SIGKILL);
  return done;
}
size_t fwrite(const void *data, size_t size, size_t count, FILE *file) {
  MEET(WRITE, fd_below(fileno(file)), 0, REAL(fwrite)(data, size, count, file))
}
int close(int fd) { MEET_CLOSING(fd_below(fd), -1, REAL(close)(fd)) }
int fclose(FILE *file) { MEET_CLOSING(fd_below(fileno(file)), EOF, REAL(fclose)(file)) }

int clock_gettime(clockid_t clock, struct timespec *now) {
  static int (*real)(clockid_t, struct timespec *);
  if (real == NULL) real = REAL(clock_gettime);
  int result = real(clock, now);
  if (clock == CLOCK_REALTIME) now->tv_sec += clock_shift;
  return result;
}
