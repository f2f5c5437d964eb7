/* Five hops of one message through four processes over TCP on the loopback, once a cycle: the reference of the live
 * benchmark. Robot Server -> HLI -> controller -> HLI -> gate -> Robot Server, and no work at any of them.
 *
 *     hops CYCLE_NS CYCLES BYTES FILE
 *
 * FILE gets six 64-bit numbers a cycle: when the message was sent, and when each of the five hops had it; of
 * CLOCK_MONOTONIC [ns], 0 where the message did not come back before the end.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { STAMPS = 6, NS = 1000000000 };

struct message {
    int64_t number;
    int64_t at_ns[STAMPS];
};

static size_t bytes;

static void fail(const char *what) {
    perror(what);
    exit(1);
}

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * (int64_t)NS + now.tv_nsec;
}

/* two ends of one connection */
static void connected(int ends[2]) {
    struct sockaddr_in where = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t length = sizeof where;
    int listener = socket(AF_INET, SOCK_STREAM, 0), on = 1;
    if (listener < 0 || bind(listener, (struct sockaddr *)&where, sizeof where) || listen(listener, 1) ||
        getsockname(listener, (struct sockaddr *)&where, &length))
        fail("listen");
    ends[0] = socket(AF_INET, SOCK_STREAM, 0);
    if (ends[0] < 0 || connect(ends[0], (struct sockaddr *)&where, sizeof where)) fail("connect");
    ends[1] = accept(listener, NULL, NULL);
    if (ends[1] < 0) fail("accept");
    for (int end = 0; end < 2; end++) setsockopt(ends[end], IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    close(listener);
}

/* 0 at the end of the connection */
static int receive(int from, char *message) {
    for (size_t have = 0; have < bytes;) {
        ssize_t count = recv(from, message + have, bytes - have, 0);
        if (count < 0 && errno == EINTR) continue;
        if (count <= 0) return 0;
        have += (size_t)count;
    }
    return 1;
}

static void hand_on(int to, char *message) {
    for (size_t sent = 0; sent < bytes;) {
        ssize_t count = send(to, message + sent, bytes - sent, MSG_NOSIGNAL);
        if (count < 0 && errno == EINTR) continue;
        if (count <= 0) exit(0); /* the next one has ended */
        sent += (size_t)count;
    }
}

/* the priorities of the services: SCHED_FIFO if positive and allowed, else a nice value */
static void ask_for(int priority) {
    struct sched_param wanted = {.sched_priority = priority};
    if (priority <= 0 || sched_setscheduler(0, SCHED_FIFO, &wanted)) setpriority(PRIO_PROCESS, 0, -10);
}

/* a process that hands on what comes; `hops[i]` is which hop its i-th input is */
static void stand_between(int priority, int inputs, const int *from, const int *to, const int *hops) {
    char *message = calloc(1, bytes);
    struct pollfd ready[2];
    ask_for(priority);
    for (int i = 0; i < inputs; i++) ready[i] = (struct pollfd){.fd = from[i], .events = POLLIN};
    for (;;) {
        if (poll(ready, (nfds_t)inputs, -1) < 0 && errno != EINTR) exit(1);
        for (int i = 0; i < inputs; i++) {
            if (!ready[i].revents) continue;
            if (!receive(from[i], message)) exit(0);
            ((struct message *)message)->at_ns[hops[i]] = now_ns();
            hand_on(to[i], message);
        }
    }
}

static pid_t begin(int ends[5][2], int own_from, int own_from2, int own_to, int own_to2) {
    pid_t child = fork();
    if (child < 0) fail("fork");
    if (child == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        for (int link = 0; link < 5; link++) {
            if (link != own_from && link != own_from2) close(ends[link][1]);
            if (link != own_to && link != own_to2) close(ends[link][0]);
        }
    }
    return child;
}

int main(int count, char **arguments) {
    if (count != 5) {
        fprintf(stderr, "usage: hops CYCLE_NS CYCLES BYTES FILE\n");
        return 2;
    }
    int64_t cycle_ns = atoll(arguments[1]), cycles = atoll(arguments[2]);
    bytes = (size_t)atoll(arguments[3]);
    if (cycle_ns <= 0 || cycles <= 0 || bytes < sizeof(struct message)) return 2;
    int64_t(*rows)[STAMPS] = calloc((size_t)cycles, sizeof *rows);
    int ends[5][2]; /* link i carries hop i + 1, from ends[i][0] to ends[i][1] */
    for (int link = 0; link < 5; link++) connected(ends[link]);

    if (begin(ends, 0, 2, 1, 3) == 0)
        stand_between(9, 2, (int[]){ends[0][1], ends[2][1]}, (int[]){ends[1][0], ends[3][0]}, (int[]){1, 3});
    if (begin(ends, 1, -1, 2, -1) == 0)
        stand_between(0, 1, (int[]){ends[1][1]}, (int[]){ends[2][0]}, (int[]){2});
    if (begin(ends, 3, -1, 4, -1) == 0)
        stand_between(10, 1, (int[]){ends[3][1]}, (int[]){ends[4][0]}, (int[]){4});
    for (int link = 0; link < 5; link++) {
        if (link != 4) close(ends[link][1]);
        if (link != 0) close(ends[link][0]);
    }
    int out = ends[0][0], back = ends[4][1];
    ask_for(20);

    char *message = calloc(1, bytes);
    struct message *head = (struct message *)message;
    struct pollfd ready = {.fd = back, .events = POLLIN};
    int64_t due_ns = now_ns();
    /* one cycle more than are sent, for the last one to come back in */
    for (int64_t cycle = 0; cycle <= cycles; cycle++) {
        if (cycle < cycles) {
            memset(message, 0, bytes);
            head->number = cycle;
            rows[cycle][0] = head->at_ns[0] = now_ns();
            hand_on(out, message);
        }
        due_ns += cycle_ns;
        for (;;) {
            int64_t left_ns = due_ns - now_ns();
            if (left_ns <= 0) break;
            struct timespec left = {.tv_sec = left_ns / NS, .tv_nsec = left_ns % NS};
            if (ppoll(&ready, 1, &left, NULL) <= 0) continue;
            if (!receive(back, message)) return 1;
            head->at_ns[5] = now_ns();
            memcpy(rows[head->number], head->at_ns, sizeof *rows);
        }
    }
    FILE *file = fopen(arguments[4], "wb");
    if (!file || fwrite(rows, sizeof *rows, (size_t)cycles, file) != (size_t)cycles || fclose(file)) fail(arguments[4]);
    close(out); /* the others end one after the other */
    while (wait(NULL) > 0) {}
    return 0;
}
