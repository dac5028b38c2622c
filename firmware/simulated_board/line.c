#include "line.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <stdlib.h>
#include <string.h>
#include <sys/inotify.h>
#include <termios.h>
#include <unistd.h>

#include "panel.h"

static void give_up(const char *what) {
    fprintf(stderr, "simulated_board: %s: %s\n", what, strerror(errno));
    exit(1);
}

void line_plug(line_t *line) {
    struct termios raw;
    memset(&raw, 0, sizeof raw);
    cfmakeraw(&raw);
    /* The slave stays open here, so that the master survives a host that comes and goes. */
    if (openpty(&line->master, &line->slave, line->name, &raw, 0)) give_up("no pseudo-terminal");
    fcntl(line->master, F_SETFL, fcntl(line->master, F_GETFL) | O_NONBLOCK);
    line->watch = inotify_init1(IN_NONBLOCK);
    if (line->watch >= 0) inotify_add_watch(line->watch, line->name, IN_OPEN);
    line->out_length = line->in_length = 0;
    if (line->link) {
        unlink(line->link);
        if (symlink(line->name, line->link)) give_up(line->link);
    }
}

void line_unplug(line_t *line) {
    if (line->link) unlink(line->link);
    if (line->watch >= 0) close(line->watch);
    close(line->slave);
    close(line->master);
}

static void put(line_t *line, uint8_t byte) {
    if (line->out_length < sizeof line->out)
        line->out[line->out_length++] = byte;
    else
        ++line->overrun;
}

void line_send(line_t *line, uint8_t byte) {
    double draw = line->flip + line->drop + line->duplicate > 0 ? random_uniform(&line->random_state) : 1;
    uint8_t fate = FATE_WHOLE, sent = byte;
    if (draw < line->flip) {
        fate = FATE_FLIPPED;
        sent ^= (uint8_t)(1 + (int)(255 * random_uniform(&line->random_state)));
    } else if (draw < line->flip + line->drop) {
        fate = FATE_DROPPED;
    } else if (draw < line->flip + line->drop + line->duplicate) {
        fate = FATE_DUPLICATED;
        put(line, sent);
    }
    if (fate != FATE_DROPPED) put(line, sent);
    ++line->sent;
    line->flipped += fate == FATE_FLIPPED;
    line->dropped += fate == FATE_DROPPED;
    line->duplicated += fate == FATE_DUPLICATED;
    if (line->log) {
        putc(byte, line->log);
        putc(fate, line->log);
    }
}

static int opened(line_t *line) {
    char events[4096];
    return line->watch >= 0 && read(line->watch, events, sizeof events) > 0;
}

static void take_in(line_t *line) {
    ssize_t length = read(line->master, line->in + line->in_length, sizeof line->in - line->in_length);
    if (length > 0) line->in_length += (size_t)length;
}

static void hand_out(line_t *line) {
    ssize_t length = write(line->master, line->out, line->out_length);
    if (length <= 0) return;
    line->out_length -= (size_t)length;
    memmove(line->out, line->out + length, line->out_length);
}

int line_pump(line_t *line, volatile int *quit) {
    int news = opened(line);
    take_in(line);
    while (line->out_length && !news && !*quit) {
        hand_out(line);
        if (!line->out_length) break;
        if (line->real_time) {
            line->overrun += line->out_length;
            line->out_length = 0;
            break;
        }
        struct pollfd wait[] = {{line->master, POLLOUT, 0}, {line->watch, POLLIN, 0}};
        poll(wait, line->watch >= 0 ? 2 : 1, 100);
        news = opened(line);
        if (line->in_length < sizeof line->in) take_in(line);
    }
    if (news) {
        /* What was sent while nobody listened is gone. */
        tcflush(line->slave, TCIFLUSH);
        line->out_length = line->in_length = 0;
    }
    return news;
}
