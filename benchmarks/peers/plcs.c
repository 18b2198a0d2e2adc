/* Many PLCs in one process, or the loop that reads them: the limit of what this machine can do (benchmarks/peers).
 *
 * plcs serve PORT COUNT   COUNT servers on 127.0.0.1, ports PORT, PORT + 1, ...; Modbus TCP, functions 3, 4, 6 and 16.
 *     Holding register 0 counts tenths of a second, 1 to 9 wander; what is written is kept. Of every request 24 bytes
 *     go to standard output: monotonic seconds when it was answered (double), number of the PLC, connection, function,
 *     address, count (5 uint16), padding. It ends with standard input.
 * plcs poll PORT COUNT PERIOD SECONDS   reads ten registers of each every PERIOD seconds on absolute deadlines, their
 *     phases spread over the period. With PERIOD 0 as fast as it goes: prints the polls a second.
 */
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

enum { REGISTERS = 256, BUFFER = 4096, EVENTS = 256 };

typedef struct { int fd, plc, listening, have; uint16_t number; uint8_t data[BUFFER]; } peer;
typedef struct { double at; uint16_t plc, connection, function, address, count, unused[3]; } row;

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void fail(const char *what) { perror(what); exit(1); }

static struct sockaddr_in place(int port) {
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_port = htons(port), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    return a;
}

static uint16_t (*image)[REGISTERS];

/* The reply to one whole request; its length. */
static int answer(int plc, const uint8_t *q, uint8_t *r) {
    unsigned function = q[7], address = q[8] << 8 | q[9], count = q[10] << 8 | q[11], n = 2;
    memcpy(r, q, 8);
    if (address + (function == 6 ? 1 : count) > REGISTERS || (function <= 4 && count > 125)) {
        r[7] |= 0x80; r[8] = 2; n = 3;
    } else if (function == 3 || function == 4) {
        double t = now();
        r[8] = 2 * count;
        for (unsigned i = 0; i < count; i++) {
            unsigned a = address + i;
            uint16_t v = a == 0 ? (uint16_t)(t * 10.0) : a < 10 ? (uint16_t)(1000 * a + (unsigned)(t * a) % 50) : image[plc][a];
            r[9 + 2 * i] = v >> 8; r[10 + 2 * i] = v;
        }
        n = 3 + 2 * count;
    } else if (function == 6) {
        image[plc][address] = count; memcpy(r + 8, q + 8, 4); n = 6;
    } else if (function == 16) {
        for (unsigned i = 0; i < count; i++) image[plc][address + i] = q[13 + 2 * i] << 8 | q[14 + 2 * i];
        memcpy(r + 8, q + 8, 4); n = 6;
    } else {
        r[7] |= 0x80; r[8] = 1; n = 3;
    }
    r[4] = n >> 8; r[5] = n;
    return 6 + n;
}

static void serve(int port, int count) {
    int all = epoll_create1(0);
    uint16_t connections = 0;
    image = calloc(count, sizeof *image);
    for (int i = 0; i <= count; i++) {
        peer *p = calloc(1, sizeof *p);
        p->listening = 1; p->plc = i;
        if (i < count) {
            struct sockaddr_in a = place(port + i);
            int one = 1;
            p->fd = socket(AF_INET, SOCK_STREAM, 0);
            setsockopt(p->fd, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
            if (bind(p->fd, (struct sockaddr *)&a, sizeof a) || listen(p->fd, 16)) fail("listen");
        } else p->fd = 0; /* standard input: it ends when the parent does */
        struct epoll_event e = {.events = EPOLLIN, .data.ptr = p};
        epoll_ctl(all, EPOLL_CTL_ADD, p->fd, &e);
    }
    fprintf(stderr, "ready\n");
    for (;;) {
        struct epoll_event events[EVENTS];
        int n = epoll_wait(all, events, EVENTS, -1);
        for (int i = 0; i < n; i++) {
            peer *p = events[i].data.ptr;
            if (p->listening && p->fd == 0) {
                char c;
                if (read(0, &c, 1) <= 0) return;
            } else if (p->listening) {
                peer *q = calloc(1, sizeof *q);
                int one = 1;
                q->fd = accept(p->fd, NULL, NULL); q->plc = p->plc; q->number = connections++;
                setsockopt(q->fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
                struct epoll_event e = {.events = EPOLLIN, .data.ptr = q};
                epoll_ctl(all, EPOLL_CTL_ADD, q->fd, &e);
            } else {
                ssize_t got = read(p->fd, p->data + p->have, BUFFER - p->have);
                if (got <= 0) { close(p->fd); free(p); continue; }
                p->have += got;
                int at = 0;
                while (p->have - at >= 6) {
                    const uint8_t *q = p->data + at;
                    int length = 6 + (q[4] << 8 | q[5]);
                    uint8_t reply[300];
                    if (length < 12 || p->have - at < length) break;
                    int size = answer(p->plc, q, reply);
                    if (write(p->fd, reply, size) != size) break;
                    row r = {now(), p->plc, p->number, q[7], q[8] << 8 | q[9], q[10] << 8 | q[11], {0}};
                    if (write(1, &r, sizeof r) != sizeof r) return;
                    at += length;
                }
                memmove(p->data, p->data + at, p->have -= at);
            }
        }
    }
}

static void read_ten(int fd, uint16_t number) {
    uint8_t q[12] = {number >> 8, number, 0, 0, 0, 6, 1, 3, 0, 0, 0, 10}, r[260];
    if (write(fd, q, sizeof q) != sizeof q) fail("write");
    for (int have = 0; have < 29;) {
        ssize_t got = read(fd, r + have, sizeof r - have);
        if (got <= 0) fail("read");
        have += got;
    }
    if (r[0] != q[0] || r[1] != q[1] || r[7] != 3 || r[8] != 20) { fprintf(stderr, "wrong reply\n"); exit(1); }
}

static void poll_all(int port, int count, double period, double seconds) {
    int *fds = calloc(count, sizeof *fds), one = 1;
    for (int i = 0; i < count; i++) {
        struct sockaddr_in a = place(port + i);
        fds[i] = socket(AF_INET, SOCK_STREAM, 0);
        if (connect(fds[i], (struct sockaddr *)&a, sizeof a)) fail("connect");
        setsockopt(fds[i], IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    }
    double begin = now();
    long polls = 0;
    for (; now() - begin < seconds; polls++) {
        double due = begin + (polls / count) * period + (polls % count) * period / count, left = due - now();
        if (left > 0) {
            struct timespec t = {(time_t)left, (long)((left - (time_t)left) * 1e9)};
            nanosleep(&t, NULL);
        }
        read_ten(fds[polls % count], (uint16_t)polls);
    }
    printf("%.0f\n", polls / (now() - begin));
}

int main(int argc, char **argv) {
    signal(SIGPIPE, SIG_IGN);
    struct rlimit files = {4096, 4096};
    setrlimit(RLIMIT_NOFILE, &files);
    if (argc == 4 && !strcmp(argv[1], "serve")) serve(atoi(argv[2]), atoi(argv[3]));
    else if (argc == 6 && !strcmp(argv[1], "poll")) poll_all(atoi(argv[2]), atoi(argv[3]), atof(argv[4]), atof(argv[5]));
    else { fprintf(stderr, "serve PORT COUNT | poll PORT COUNT PERIOD SECONDS\n"); return 2; }
    return 0;
}
