/* Makes the n-th open, write, fsync, rename or close below one folder fail: scripts/faults.py.
 *
 * Loaded before the C library (LD_PRELOAD), it stands for these calls of Python and of every
 * library. It does nothing until faults_arm was called, in the process that is to meet the fault.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/sendfile.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { OPEN, WRITE, FSYNC, RENAME, CLOSE, KINDS };
enum { KILL = -1, SHORT = -2 };

static char below[4096];
static int kind = -1, fault;
static long wanted;
static long *seen; /* how often each kind was called; shared with whoever armed it */

void faults_arm(const char *folder, int of, long number, int what, long *counts) {
  snprintf(below, sizeof below, "%s", folder);
  wanted = number, fault = what, seen = counts, kind = of;
}

static int is_below(const char *path) {
  size_t length = strlen(below);
  return strncmp(path, below, length) == 0 && (path[length] == '/' || path[length] == 0);
}

static int fd_below(int fd) {
  char link[64], path[4096];
  int old = errno;
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  ssize_t length = readlink(link, path, sizeof path - 1);
  errno = old;
  return length > 0 && (path[length] = 0, is_below(path));
}

static int path_below(int folder, const char *path) {
  char whole[8192], link[64], base[4096];
  if (path == NULL || path[0] == '/') return path != NULL && is_below(path);
  if (folder == AT_FDCWD) snprintf(link, sizeof link, "/proc/self/cwd");
  else snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
  ssize_t length = readlink(link, base, sizeof base - 1);
  if (length <= 0) return 0;
  base[length] = 0;
  snprintf(whole, sizeof whole, "%s/%s", base, path);
  return is_below(whole);
}

/* 0: go on; else what is to happen. A full disk stays full. */
static int due(int of) {
  if (kind < 0) return 0;
  long now = __atomic_add_fetch(&seen[of], 1, __ATOMIC_SEQ_CST);
  if (of != kind) return 0;
  return now == wanted || (now > wanted && fault == ENOSPC && of == WRITE) ? fault : 0;
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define MEET(of, mine, call)                           \
  do {                                                 \
    int what = (mine) ? due(of) : 0;                   \
    if (what > 0) { errno = what; return -1; }         \
    __typeof__(call) result = call;                    \
    if (what == KILL) kill(getpid(), SIGKILL);         \
    return result;                                     \
  } while (0)

#define OPENING(name)                                                    \
  int name(const char *path, int flags, ...) {                           \
    va_list rest;                                                        \
    va_start(rest, flags);                                               \
    mode_t mode = va_arg(rest, mode_t);                                  \
    va_end(rest);                                                        \
    MEET(OPEN, path_below(AT_FDCWD, path), REAL(name)(path, flags, mode)); \
  }
OPENING(open)
OPENING(open64)

#define OPENING_AT(name)                                                      \
  int name(int folder, const char *path, int flags, ...) {                    \
    va_list rest;                                                             \
    va_start(rest, flags);                                                    \
    mode_t mode = va_arg(rest, mode_t);                                       \
    va_end(rest);                                                             \
    MEET(OPEN, path_below(folder, path), REAL(name)(folder, path, flags, mode)); \
  }
OPENING_AT(openat)
OPENING_AT(openat64)

#define OPENING_FILE(name)                                                  \
  FILE *name(const char *path, const char *mode) {                          \
    int what = path_below(AT_FDCWD, path) ? due(OPEN) : 0;                  \
    if (what > 0) { errno = what; return NULL; }                            \
    FILE *file = REAL(name)(path, mode);                                    \
    if (what == KILL) kill(getpid(), SIGKILL);                              \
    return file;                                                            \
  }
OPENING_FILE(fopen)
OPENING_FILE(fopen64)

ssize_t write(int fd, const void *data, size_t count) {
  int what = kind >= 0 && fd_below(fd) ? due(WRITE) : 0;
  if (what > 0) { errno = what; return -1; }
  if (what == SHORT && count > 1) count /= 2;
  ssize_t done = REAL(write)(fd, data, count);
  if (what == KILL) kill(getpid(), SIGKILL);
  return done;
}
size_t fwrite(const void *data, size_t size, size_t count, FILE *file) {
  int what = kind >= 0 && fd_below(fileno(file)) ? due(WRITE) : 0;
  if (what > 0) { errno = what; return 0; }
  size_t done = REAL(fwrite)(data, size, count, file);
  if (what == KILL) kill(getpid(), SIGKILL);
  return done;
}
ssize_t writev(int fd, const struct iovec *data, int count) { MEET(WRITE, kind >= 0 && fd_below(fd), REAL(writev)(fd, data, count)); }
ssize_t pwrite64(int fd, const void *data, size_t count, off64_t at) { MEET(WRITE, kind >= 0 && fd_below(fd), REAL(pwrite64)(fd, data, count, at)); }
ssize_t sendfile64(int to, int from, off64_t *at, size_t count) { MEET(WRITE, kind >= 0 && fd_below(to), REAL(sendfile64)(to, from, at, count)); }
int fsync(int fd) { MEET(FSYNC, kind >= 0 && fd_below(fd), REAL(fsync)(fd)); }
int fdatasync(int fd) { MEET(FSYNC, kind >= 0 && fd_below(fd), REAL(fdatasync)(fd)); }
int rename(const char *from, const char *to) { MEET(RENAME, path_below(AT_FDCWD, to), REAL(rename)(from, to)); }
int renameat(int a, const char *from, int b, const char *to) { MEET(RENAME, path_below(b, to), REAL(renameat)(a, from, b, to)); }

/* A file is closed in any case, as Linux does it. */
int close(int fd) {
  int what = kind >= 0 && fd_below(fd) ? due(CLOSE) : 0;
  int result = REAL(close)(fd);
  if (what == KILL) kill(getpid(), SIGKILL);
  if (what > 0) { errno = what; return -1; }
  return result;
}
int fclose(FILE *file) {
  int what = kind >= 0 && fd_below(fileno(file)) ? due(CLOSE) : 0;
  int result = REAL(fclose)(file);
  if (what == KILL) kill(getpid(), SIGKILL);
  if (what > 0) { errno = what; return EOF; }
  return result;
}
