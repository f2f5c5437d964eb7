/* A KRC that only sends telegrams and takes the time until each is answered: by a Robot Server, and by an echo of its
 * own beside it, which nothing of a Robot Server delays. Three quarters of a cycle lie between the two.
 *
 *     asker CYCLE_NS ADDRESS PORT TELEGRAMS FILE
 *
 * TELEGRAMS holds datagrams, each behind its length in 32 bits. FILE gets two 64-bit numbers a telegram: how long the
 * Robot Server took for it, and the echo [ns]; -1 where no answer came before its next turn.
 */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

enum { MOST_BYTES = 65536, ECHO_PRIORITY = 29, ASKER_PRIORITY = 30, NS = 1000000000 };

static char received[MOST_BYTES];

static void fail(const char *what) {
    perror(what);
    exit(1);
}

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * (int64_t)NS + now.tv_nsec;
}

static void ask_for(int priority) {
    struct sched_param wanted = {.sched_priority = priority};
    sched_setscheduler(0, SCHED_FIFO, &wanted); /* where it is refused, the Robot Server has none either */
}

static int bound(struct sockaddr_in *where) {
    socklen_t length = sizeof *where;
    int made = socket(AF_INET, SOCK_DGRAM, 0);
    *where = (struct sockaddr_in){.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    if (made < 0 || bind(made, (struct sockaddr *)where, length) ||
        getsockname(made, (struct sockaddr *)where, &length))
        fail("bind");
    return made;
}

static void echo(int from) {
    ask_for(ECHO_PRIORITY);
    for (;;) {
        struct sockaddr_in sender;
        socklen_t length = sizeof sender;
        ssize_t bytes = recvfrom(from, received, sizeof received, 0, (struct sockaddr *)&sender, &length);
        if (bytes > 0) sendto(from, received, (size_t)bytes, 0, (struct sockaddr *)&sender, length);
    }
}

/* how long an answer took, -1 if none came by `until_ns`; returns at that time in any case */
static int64_t asked(int own, const struct sockaddr_in *whom, const char *telegram, uint32_t bytes, int64_t until_ns) {
    struct pollfd ready = {.fd = own, .events = POLLIN};
    int64_t took_ns = -1, sent_ns = now_ns();
    if (sendto(own, telegram, bytes, 0, (const struct sockaddr *)whom, sizeof *whom) < 0) return -1;
    for (;;) {
        int64_t left_ns = until_ns - now_ns();
        if (left_ns <= 0) return took_ns;
        struct timespec left = {.tv_sec = left_ns / NS, .tv_nsec = left_ns % NS};
        if (ppoll(&ready, 1, &left, NULL) <= 0) continue;
        ssize_t count = recv(own, received, sizeof received, MSG_DONTWAIT);
        if (count > 0 && took_ns < 0) took_ns = now_ns() - sent_ns;
    }
}

int main(int count, char **arguments) {
    if (count != 6) {
        fprintf(stderr, "usage: asker CYCLE_NS ADDRESS PORT TELEGRAMS FILE\n");
        return 2;
    }
    int64_t cycle_ns = atoll(arguments[1]);
    struct sockaddr_in server = {.sin_family = AF_INET, .sin_port = htons((uint16_t)atoi(arguments[3]))}, own, other;
    if (cycle_ns <= 0 || inet_pton(AF_INET, arguments[2], &server.sin_addr) != 1) return 2;
    int to_server = bound(&own), to_echo = bound(&own), of_echo = bound(&other);
    pid_t child = fork();
    if (child < 0) fail("fork");
    if (child == 0) {
        prctl(PR_SET_PDEATHSIG, SIGKILL);
        echo(of_echo);
    }
    FILE *telegrams = fopen(arguments[4], "rb"), *file = fopen(arguments[5], "wb");
    if (!telegrams || !file) fail("files");
    ask_for(ASKER_PRIORITY);
    static char telegram[MOST_BYTES];
    int64_t due_ns = now_ns();
    for (uint32_t bytes; fread(&bytes, sizeof bytes, 1, telegrams) == 1; due_ns += cycle_ns) {
        if (bytes > MOST_BYTES || fread(telegram, 1, bytes, telegrams) != bytes) return 1;
        int64_t took_ns[2];
        took_ns[0] = asked(to_server, &server, telegram, bytes, due_ns + cycle_ns / 4 * 3);
        took_ns[1] = asked(to_echo, &other, telegram, bytes, due_ns + cycle_ns);
        if (fwrite(took_ns, sizeof took_ns, 1, file) != 1) fail("write");
    }
    if (fclose(file)) fail("close");
    kill(child, SIGKILL);
    wait(NULL);
    return 0;
}
