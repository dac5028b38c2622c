/* A sketch on portable_scan.h as a program of this computer, behind a pseudo-terminal, with a simulated panel on its
 * pins: Arduino.h for the compiler of this computer, and the time that a board would need. The sketch begins when a host
 * opens the port, and its time stands still while the host does not read. */
#include <getopt.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#include "Arduino.h"

extern "C" {
#include "../line.h"
#include "../panel.h"
}
#include "pins.h"

#define CONVERSION_US 25 /* of analogRead on boards with a floating-point unit */
#define IDLE_US 20       /* from one loop() to the next */
#define PUMP_US 5000
#define PUMP_NAP_NS 20000 /* hosts believe clocks that run up to a thousand times too fast */

static panel_t panel;
static line_t line;
static uint64_t time_us, pumped_us, first_us;
static bool scanned;
static uint8_t levels[256];
static volatile int quit;

static double panel_s() {
    return scanned ? 1e-6 * (double)(time_us - first_us) : 0;
}

static void pump() {
    pumped_us = time_us;
    line_pump(&line, &quit);
    const struct timespec nap = {0, PUMP_NAP_NS};
    nanosleep(&nap, 0);
}

static void pass(uint64_t microseconds) {
    time_us += microseconds;
    if (time_us - pumped_us >= PUMP_US) pump();
}

static int line_at(const uint8_t *pins, const uint8_t *channels) {
    int channel = 0;
    for (int bit = 0; bit < 4; ++bit) channel |= levels[pins[bit]] << bit;
    for (int number = 0; number < 16; ++number)
        if (channels[number] == channel) return number;
    return -1;
}

void pinMode(uint8_t pin, uint8_t mode) {
    (void)pin, (void)mode;
}

void digitalWrite(uint8_t pin, uint8_t level) {
    static const uint8_t row_pins[] = LAMPEST_ROW_PINS, column_pins[] = LAMPEST_COLUMN_PINS;
    static const uint8_t row_channels[] = LAMPEST_ROW_CHANNELS, column_channels[] = LAMPEST_COLUMN_CHANNELS;
    if (levels[pin] == level) return;
    levels[pin] = level;
    panel_select(&panel, line_at(row_pins, row_channels), line_at(column_pins, column_channels), panel_s());
}

void analogReadResolution(int bits) {
    if (bits != LAMPEST_ADC_BITS) abort();
}

int analogRead(uint8_t pin) {
    if (pin != LAMPEST_ADC_PIN) abort();
    if (!scanned) {
        scanned = true;
        first_us = time_us;
        panel.switched_s = -1;
        panel.row = panel.column = 0;
    }
    const int code = panel_code(&panel, panel_s());
    pass(CONVERSION_US);
    return code;
}

void delayMicroseconds(unsigned microseconds) {
    pass(microseconds);
}

uint32_t micros() {
    return (uint32_t)time_us;
}

uint32_t millis() {
    return (uint32_t)(time_us / 1000);
}

void SerialLine::begin(long baud) {
    (void)baud;
}

int SerialLine::available() {
    return (int)line.in_length;
}

int SerialLine::read() {
    const uint8_t byte = line.in[0];
    memmove(line.in, line.in + 1, --line.in_length);
    return byte;
}

size_t SerialLine::write(uint8_t byte) {
    line_send(&line, byte);
    return 1;
}

void SerialLine::print(const char *text) {
    while (*text) write((uint8_t)*text++);
}

void SerialLine::print(char sign) {
    write((uint8_t)sign);
}

void SerialLine::print(long number) {
    char text[32];
    snprintf(text, sizeof text, "%ld", number);
    print(text);
}

void SerialLine::print(double number, int digits) {
    char text[64];
    snprintf(text, sizeof text, "%.*f", digits, number);
    print(text);
}

SerialLine Serial;

static void on_signal(int number) {
    (void)number;
    quit = 1;
}

static const char usage[] =
    "portable_board --truth FILE [options]: the options of simulated_board that have the same meaning\n"
    "  --noise-lsb S --seed N --flip P --drop P --duplicate P --link PATH\n";
enum { OPT_TRUTH = 256, OPT_NOISE, OPT_SEED, OPT_FLIP, OPT_DROP, OPT_DUPLICATE, OPT_LINK };
static const struct option options[] = {{"truth", 1, 0, OPT_TRUTH},         {"noise-lsb", 1, 0, OPT_NOISE},
                                        {"seed", 1, 0, OPT_SEED},           {"flip", 1, 0, OPT_FLIP},
                                        {"drop", 1, 0, OPT_DROP},           {"duplicate", 1, 0, OPT_DUPLICATE},
                                        {"link", 1, 0, OPT_LINK},           {0, 0, 0, 0}};

int main(int count, char **words) {
    const char *truth = 0;
    int option;
    panel.settle_s = 2e-6;
    panel.noise_lsb = 0.7;
    panel.random_state = 1;
    line.random_state = ~UINT64_C(1);
    for (int number = 0; number < 16; ++number) panel.row_ohm[number] = panel.column_ohm[number] = 70;
    while ((option = getopt_long(count, words, "", options, 0)) != -1) switch (option) {
            case OPT_TRUTH: truth = optarg; break;
            case OPT_NOISE: panel.noise_lsb = atof(optarg); break;
            case OPT_SEED:
                panel.random_state = strtoull(optarg, 0, 10);
                line.random_state = ~panel.random_state;
                break;
            case OPT_FLIP: line.flip = atof(optarg); break;
            case OPT_DROP: line.drop = atof(optarg); break;
            case OPT_DUPLICATE: line.duplicate = atof(optarg); break;
            case OPT_LINK: line.link = optarg; break;
            default: fputs(usage, stderr); return 2;
        }
    if (!truth) {
        fputs(usage, stderr);
        return 2;
    }
    panel_read(&panel, truth);
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_handler = on_signal;
    sigaction(SIGINT, &action, 0);
    sigaction(SIGTERM, &action, 0);
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    line_plug(&line);
    printf("port %s\n", line.name);
    fflush(stdout);
    const struct timespec nap = {0, 1000000};
    while (!quit && !line_pump(&line, &quit)) nanosleep(&nap, 0); /* until a host opens the port */
    for (setup(); !quit; pass(IDLE_US)) loop();
    line_unplug(&line);
    fprintf(stderr, "{\"board_s\": %.6f, \"bytes\": %lu, \"flipped\": %lu}\n", 1e-6 * (double)time_us, line.sent, line.flipped);
    return 0;
}
