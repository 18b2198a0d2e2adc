/* Keeps a journal of what a process does to the files of one folder, in the order in which it is done, so that the
 * state of a disk that loses what was not synced can be made up for any moment (`tests.rig.power_cut`).
 *
 * To be preloaded (LD_PRELOAD). JOURNAL_FOLDER is the folder, JOURNAL_FILE where the journal is appended. One lock is
 * held over a call and its row: the journal's order is the order of the calls. A sync counts from its row on, which is
 * written when it has come back. Files that are mapped into memory are not followed: SQLite maps only its index of the
 * write-ahead log, which it makes anew after a power cut. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

enum { WRITE = 1, TRUNCATE, SYNC, REMOVE, RENAME };

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static int journal = -1;
static char folder[PATH_MAX];
static size_t folder_length;

static ssize_t (*real_write)(int, const void *, size_t);
static ssize_t (*real_pwrite)(int, const void *, size_t, off_t);
static int (*real_ftruncate)(int, off_t);
static int (*real_fsync)(int);
static int (*real_fdatasync)(int);
static int (*real_unlink)(const char *);
static int (*real_rename)(const char *, const char *);

__attribute__((constructor)) static void begin(void) {
    real_write = dlsym(RTLD_NEXT, "write");
    real_pwrite = dlsym(RTLD_NEXT, "pwrite64");
    real_ftruncate = dlsym(RTLD_NEXT, "ftruncate64");
    real_fsync = dlsym(RTLD_NEXT, "fsync");
    real_fdatasync = dlsym(RTLD_NEXT, "fdatasync");
    real_unlink = dlsym(RTLD_NEXT, "unlink");
    real_rename = dlsym(RTLD_NEXT, "rename");
    const char *where = getenv("JOURNAL_FOLDER"), *file = getenv("JOURNAL_FILE");
    if (!where || !file || !realpath(where, folder)) return;
    folder_length = strlen(folder);
    journal = open(file, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
}

static int inside(const char *path) {
    return journal >= 0 && strncmp(path, folder, folder_length) == 0 && (path[folder_length] == '/' || !path[folder_length]);
}

static int path_of(int fd, char *path) {
    char link[64];
    if (journal < 0 || fd == journal) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, PATH_MAX - 1);
    if (length <= 0) return 0;
    path[length] = 0;
    return inside(path);
}

static void row(int kind, const char *path, uint64_t offset, const void *data, uint64_t size) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    struct { uint64_t time, offset, size; uint32_t kind, path; } head = {
        now.tv_sec * 1000000000ull + now.tv_nsec, offset, size, kind, strlen(path)};
    struct iovec parts[] = {{&head, sizeof head}, {(void *)path, head.path}, {(void *)data, data ? size : 0}};
    if (writev(journal, parts, 3) < 0) abort();
}

ssize_t pwrite64(int fd, const void *data, size_t size, off_t offset) {
    char path[PATH_MAX];
    if (!path_of(fd, path)) return real_pwrite(fd, data, size, offset);
    pthread_mutex_lock(&lock);
    ssize_t done = real_pwrite(fd, data, size, offset);
    if (done > 0) row(WRITE, path, offset, data, done);
    pthread_mutex_unlock(&lock);
    return done;
}

ssize_t pwrite(int fd, const void *data, size_t size, off_t offset) { return pwrite64(fd, data, size, offset); }

ssize_t write(int fd, const void *data, size_t size) {
    char path[PATH_MAX];
    if (!path_of(fd, path)) return real_write(fd, data, size);
    pthread_mutex_lock(&lock);
    ssize_t done = real_write(fd, data, size);
    /* Where it went: appended or not, the file's position is now behind it. */
    if (done > 0) row(WRITE, path, lseek(fd, 0, SEEK_CUR) - done, data, done);
    pthread_mutex_unlock(&lock);
    return done;
}

int ftruncate64(int fd, off_t size) {
    char path[PATH_MAX];
    if (!path_of(fd, path)) return real_ftruncate(fd, size);
    pthread_mutex_lock(&lock);
    int failed = real_ftruncate(fd, size);
    if (!failed) row(TRUNCATE, path, size, NULL, 0);
    pthread_mutex_unlock(&lock);
    return failed;
}

int ftruncate(int fd, off_t size) { return ftruncate64(fd, size); }

static int synced(int fd, int (*real)(int)) {
    char path[PATH_MAX];
    if (!path_of(fd, path)) return real(fd);
    pthread_mutex_lock(&lock);
    int failed = real(fd);
    if (!failed) row(SYNC, path, 0, NULL, 0);
    pthread_mutex_unlock(&lock);
    return failed;
}

int fsync(int fd) { return synced(fd, real_fsync); }
int fdatasync(int fd) { return synced(fd, real_fdatasync); }

int unlink(const char *path) {
    char whole[PATH_MAX];
    int ours = realpath(path, whole) && inside(whole);
    pthread_mutex_lock(&lock);
    int failed = real_unlink(path);
    if (ours && !failed) row(REMOVE, whole, 0, NULL, 0);
    pthread_mutex_unlock(&lock);
    return failed;
}

int rename(const char *from, const char *to) {
    char before[PATH_MAX], after[PATH_MAX];
    int ours = realpath(from, before) && inside(before);
    pthread_mutex_lock(&lock);
    int failed = real_rename(from, to);
    if (ours && !failed && realpath(to, after)) row(RENAME, before, 0, after, strlen(after));
    pthread_mutex_unlock(&lock);
    return failed;
}
