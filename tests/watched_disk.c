/* A disk that is watched and can fail: interposed between a program and the C library (LD_PRELOAD).

   WATCHED_FOLDER  whose files count, by the beginning of their paths
   WATCHED_LOG     gets a line for every call that touches one: call, path, offset and bytes in hexadecimal
   WATCHED_FAULT   CALL:NUMBER:ERRNO makes that call fail the NUMBERth time and from then on; ERRNO 0: only every second
                   byte of a write is taken, each time */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

enum { FILES = 1024, LENGTH = 4096 };
static char paths[FILES][LENGTH];
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

static int watched(const char *path) {
    const char *folder = getenv("WATCHED_FOLDER");
    return folder && path && !strncmp(path, folder, strlen(folder));
}

static const char *path_of(int fd) { return fd >= 0 && fd < FILES && paths[fd][0] ? paths[fd] : NULL; }

/* -1: the call fails with errno; 1: it is to be cut short; 0: neither */
static int fault(const char *call) {
    static int counts;
    const char *wanted = getenv("WATCHED_FAULT");
    size_t length = strlen(call);
    int number, error;
    if (!wanted || strncmp(wanted, call, length) || wanted[length] != ':') return 0;
    if (sscanf(wanted + length, ":%d:%d", &number, &error) != 2 || ++counts < number) return 0;
    if (!error) return 1;
    errno = error;
    return -1;
}

/* EINTR is what is tried again: it happens once */
static int fails(const char *call) {
    static int interrupted;
    int found = fault(call);
    if (found < 0 && errno == EINTR && interrupted++) return 0;
    return found;
}

static void note(const char *call, const char *path, const char *other, off_t offset, const void *data, size_t size) {
    const char *name = getenv("WATCHED_LOG");
    if (!name) return;
    pthread_mutex_lock(&lock);
    FILE *log = fopen(name, "a");
    fprintf(log, "%s\t%s\t%s\t%lld\t", call, path, other ? other : "", (long long)offset);
    for (size_t i = 0; i < size; i++) fprintf(log, "%02x", ((const unsigned char *)data)[i]);
    fputc('\n', log);
    fclose(log);
    pthread_mutex_unlock(&lock);
}

int open64(const char *path, int flags, ...) {
    va_list rest;
    va_start(rest, flags);
    mode_t mode = flags & O_CREAT ? va_arg(rest, mode_t) : 0;
    va_end(rest);
    if (watched(path) && fails("open")) return -1;
    int fd = REAL(open64)(path, flags, mode);
    if (fd >= 0 && fd < FILES && watched(path)) {
        snprintf(paths[fd], LENGTH, "%s", path);
        note(flags & O_CREAT ? "create" : "open", path, NULL, 0, NULL, 0);
    }
    return fd;
}

int close(int fd) {
    if (path_of(fd)) paths[fd][0] = 0;
    return REAL(close)(fd);
}

ssize_t write(int fd, const void *data, size_t size) {
    const char *path = path_of(fd);
    if (!path) return REAL(write)(fd, data, size);
    int found = fails("write");
    if (found < 0) return -1;
    if (found) size = (size + 1) / 2;
    off_t offset = lseek64(fd, 0, SEEK_CUR);
    ssize_t written = REAL(write)(fd, data, size);
    if (written > 0) note("write", path, NULL, offset, data, written);
    return written;
}

#define ON_FD(name, declared, ...)                                                                                     \
    int name declared {                                                                                                \
        const char *path = path_of(fd);                                                                                \
        if (path && fails(#name)) return -1;                                                                           \
        int result = REAL(name)(__VA_ARGS__);                                                                          \
        if (path && !result) note(#name, path, NULL, 0, NULL, 0);                                                      \
        return result;                                                                                                 \
    }
ON_FD(fsync, (int fd), fd)
ON_FD(fdatasync, (int fd), fd)
ON_FD(flock, (int fd, int operation), fd, operation)
ON_FD(ftruncate64, (int fd, off64_t size), fd, size)
ON_FD(fstatvfs64, (int fd, struct statvfs64 *found), fd, found)

#define ON_PATH(name, declared, ...)                                                                                   \
    int name declared {                                                                                                \
        if (watched(path) && fails(#name)) return -1;                                                                  \
        int result = REAL(name)(__VA_ARGS__);                                                                          \
        if (watched(path) && !result) note(#name, path, NULL, 0, NULL, 0);                                             \
        return result;                                                                                                 \
    }
ON_PATH(unlink, (const char *path), path)
ON_PATH(mkdir, (const char *path, mode_t mode), path, mode)
ON_PATH(lstat64, (const char *path, struct stat64 *found), path, found)
ON_PATH(stat64, (const char *path, struct stat64 *found), path, found)

int rename(const char *path, const char *other) {
    if (watched(path) && fails("rename")) return -1;
    int result = REAL(rename)(path, other);
    if (watched(path) && !result) note("rename", path, other, 0, NULL, 0);
    return result;
}

int linkat(int folder, const char *path, int other_folder, const char *other, int flags) {
    if (watched(path) && fails("linkat")) return -1;
    int result = REAL(linkat)(folder, path, other_folder, other, flags);
    if (watched(path) && !result) note("linkat", path, other, 0, NULL, 0);
    return result;
}
