/* The lampest firmware on a simulated ATmega2560, behind a pseudo-terminal, with a simulated panel on its pins.
 *
 * Links libsimavr, which is under the GNU General Public License, version 3: this program is built where it is used and
 * is never distributed in binary form with lampest.
 */
#include <getopt.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#include "avr_adc.h"
#include "avr_ioport.h"
#include "avr_uart.h"
#include "line.h"
#include "panel.h"
#include "pins.h"
#include "protocol.h"
#include "sim_avr.h"
#include "sim_elf.h"

#define CLOCK_HZ 16000000u
#define SAMPLE_CYCLES 192 /* the converter samples 1.5 of its own cycles after it was started */
#define CONVERSION_CYCLES 1664
#define PUMP_CYCLES 80000 /* 5 ms */
/* Of an ATmega2560, in its data space: datasheet, register summary. */
#define ADCSRA_ADDRESS 0x7A
#define ADCSRA_ADIE 0x08
#define ADCSRB_ADDRESS 0x7B
#define ADCSRB_MUX5 0x08
#define MUX5_MODE 32 /* what MUX5 adds to the number of a multiplexer mode */
#define ADMUX_ADDRESS 0x7C
#define PAUSE_S 1e-3 /* no conversion for longer: what follows is another scan */
#define MOST_UNPLUGGED 16

typedef struct {
    avr_t *avr;
    avr_irq_t *adc, *uart_in;
    panel_t panel;
    line_t line;
    int uart_full, reset_on_open;
    int row_of_channel[16], column_of_channel[16];
    double away_s;           /* time spent unplugged, which the board's clock does not count */
    double first_s;          /* when the first conversion began, the panel's time 0; negative before */
    int at_origin;           /* the last conversion was of the first cell */
    double scan_began_s, conversion_ended_s, longest_scan_s;
    unsigned long conversions;
} bench_t;

typedef struct {
    double at_s, for_s;
} outage_t;

static volatile int quit;

static void on_signal(int number) {
    (void)number;
    quit = 1;
}

static double board_s(const bench_t *bench) { return (double)bench->avr->cycle / CLOCK_HZ; }

static double panel_s(const bench_t *bench) {
    return bench->first_s < 0 ? 0 : board_s(bench) + bench->away_s - bench->first_s;
}

static void on_select(struct avr_irq_t *irq, uint32_t value, void *param) {
    bench_t *bench = param;
    (void)irq;
    int row = bench->row_of_channel[value >> LAMPEST_ROW_SHIFT & 15];
    int column = bench->column_of_channel[value >> LAMPEST_COLUMN_SHIFT & 15];
    if (LAMPEST_WIRING == LAMPEST_LOADED_COLUMNS) {
        /* The port is written for every cell, but where the row stays nothing is switched. */
        if (row == bench->panel.row) return;
        column = bench->panel.column;
    }
    panel_select(&bench->panel, row, column, panel_s(bench));
}

/* The analog input that the firmware has chosen. */
static int chosen_input(const bench_t *bench) {
    return (bench->avr->data[ADMUX_ADDRESS] & 7) | (bench->avr->data[ADCSRB_ADDRESS] & ADCSRB_MUX5 ? 8 : 0);
}

/* simavr turns millivolt into code by mV * 1023 / Vref, rounded down. */
static void raise_code(const bench_t *bench, int input, int code) {
    avr_raise_irq(bench->adc + ADC_IRQ_ADC0 + (input & 7), (uint32_t)(code * 5000 + 1022) / 1023);
}

static void on_conversion(struct avr_irq_t *irq, uint32_t value, void *param) {
    bench_t *bench = param;
    (void)irq;
    (void)value;
    int input = chosen_input(bench);
    if (LAMPEST_WIRING == LAMPEST_LOADED_COLUMNS)
        panel_sense(&bench->panel, bench->column_of_channel[input]);
    /* Without an interrupt the board draws its identity, or a sketch reads by analogRead: such scans have no figures. */
    if (!(bench->avr->data[ADCSRA_ADDRESS] & ADCSRA_ADIE)) {
        raise_code(bench, input, panel_code(&bench->panel, board_s(bench)));
        return;
    }
    int origin = bench->panel.row == 0 && bench->panel.column == 0;
    if (origin && (!bench->at_origin || board_s(bench) - bench->conversion_ended_s > PAUSE_S)) {
        double span = bench->conversion_ended_s - bench->scan_began_s;
        if (span > bench->longest_scan_s) bench->longest_scan_s = span;
        bench->scan_began_s = board_s(bench);
    }
    bench->at_origin = origin;
    if (bench->first_s < 0) {
        bench->first_s = board_s(bench) + bench->away_s;
        bench->panel.switched_s -= 1;
    }
    int code = panel_code(&bench->panel, panel_s(bench) + (double)SAMPLE_CYCLES / CLOCK_HZ);
    raise_code(bench, input, code);
    bench->conversion_ended_s = board_s(bench) + (double)CONVERSION_CYCLES / CLOCK_HZ;
    ++bench->conversions;
}

static void on_byte(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    line_send(&((bench_t *)param)->line, (uint8_t)value);
}

static void on_uart_full(struct avr_irq_t *irq, uint32_t value, void *param) {
    (void)irq;
    ((bench_t *)param)->uart_full = value != 0;
}

/* A sleeping core jumps to the next timer; this one sees to it that the line is served on the way. */
static avr_cycle_count_t on_pump_time(avr_t *avr, avr_cycle_count_t when, void *param) {
    (void)avr;
    (void)param;
    return when + PUMP_CYCLES;
}

static void no_sleep(avr_t *avr, avr_cycle_count_t cycles) {
    (void)avr;
    (void)cycles;
}

/* simavr 1.6 has voltages for A0 to A7 only. Each is raised when its conversion begins, so A8 to A15 can share them. */
static void give_more_inputs(avr_t *avr) {
    for (avr_io_t *port = avr->io_port; port; port = port->next) {
        if (strcmp(port->kind, "adc")) continue;
        for (unsigned input = 0; input < 8; ++input)
            ((avr_adc_t *)port)->muxmode[MUX5_MODE + input] = (avr_adc_mux_t)AVR_ADC_SINGLE(input);
    }
}

static void bench_build(bench_t *bench, const char *firmware_path) {
    static const int row_channels[] = LAMPEST_ROW_CHANNELS, column_channels[] = LAMPEST_COLUMN_CHANNELS;
    elf_firmware_t firmware;
    memset(&firmware, 0, sizeof firmware);
    if (elf_read_firmware(firmware_path, &firmware)) {
        fprintf(stderr, "simulated_board: %s: cannot be read as firmware\n", firmware_path);
        exit(2);
    }
    for (int line = 0; line < 16; ++line) bench->row_of_channel[line] = bench->column_of_channel[line] = -1;
    for (int line = 0; line < 16; ++line) {
        bench->row_of_channel[row_channels[line]] = line;
        bench->column_of_channel[column_channels[line]] = line;
    }
    avr_t *avr = bench->avr = avr_make_mcu_by_name("atmega2560");
    avr_init(avr);
    firmware.frequency = CLOCK_HZ;
    avr_load_firmware(avr, &firmware);
    avr->frequency = CLOCK_HZ;
    avr->vcc = avr->avcc = avr->aref = 5000;
    avr->run_cycle_limit = 1000;
    give_more_inputs(avr);
    avr->sleep = no_sleep;
    avr_cycle_timer_register(avr, PUMP_CYCLES, on_pump_time, 0);
    uint32_t no_flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &no_flags);
    bench->adc = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, 0);
    bench->uart_in = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(LAMPEST_SELECT_PORT_LETTER), IOPORT_IRQ_REG_PORT),
                            on_select, bench);
    avr_irq_register_notify(bench->adc + ADC_IRQ_OUT_TRIGGER, on_conversion, bench);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, bench);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), on_uart_full, bench);
}

static void bench_reset(bench_t *bench) {
    avr_cycle_count_t now = bench->avr->cycle;
    uint32_t no_flags = 0;
    avr_reset(bench->avr);
    bench->avr->state = cpu_Running;
    bench->avr->cycle = now;
    avr_cycle_timer_register(bench->avr, PUMP_CYCLES, on_pump_time, 0);
    bench->uart_full = 0;
    avr_ioctl(bench->avr, AVR_IOCTL_UART_SET_FLAGS('0'), &no_flags);
}

static void bench_pump(bench_t *bench) {
    line_t *line = &bench->line;
    if (line_pump(line, &quit) && bench->reset_on_open) bench_reset(bench);
    size_t passed = 0;
    while (passed < line->in_length && !bench->uart_full) avr_raise_irq(bench->uart_in, line->in[passed++]);
    line->in_length -= passed;
    memmove(line->in, line->in + passed, line->in_length);
}

static double wall_s(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void nap(double seconds) {
    if (seconds > 0) nanosleep(&(struct timespec){(time_t)seconds, (long)(1e9 * (seconds - (double)(time_t)seconds))}, 0);
}

static void bench_unplug(bench_t *bench, double seconds, FILE *console) {
    line_unplug(&bench->line);
    nap(bench->line.real_time || seconds < 0.3 ? seconds : 0.3);
    bench->away_s += seconds;
    bench_reset(bench);
    line_plug(&bench->line);
    fprintf(console, "port %s\n", bench->line.name);
    fflush(console);
}

static void parse_ohm(const char *text, double *ohm) {
    int count = 0;
    char *end;
    for (; *text && count < 16; text = *end == ',' ? end + 1 : end) {
        ohm[count++] = strtod(text, &end);
        if (end == text || (*end && *end != ',')) break;
    }
    for (int index = count ? count : 1; index < 16; ++index) ohm[index] = count ? ohm[count - 1] : 0;
}

static const char usage[] =
    "simulated_board --firmware FILE --truth FILE [options]\n"
    "  --row-ohm R[,R...] --column-ohm R[,R...]  on-resistance of the multiplexers, per channel (70)\n"
    "  --load-ohm R[,R...]  load of each column, where columns are loaded (what pins.h says)\n"
    "  --settle-us T      time constant of the selected line (2)\n"
    "  --noise-lsb S      noise of one reading (0.7)\n"
    "  --memory F         share of the voltage converted before that the converter keeps (0)\n"
    "  --seed N           of noise and faults (1)\n"
    "  --loop             begin again after the last frame of the truth\n"
    "  --real-time        as slow as a real board; else as fast as the host reads\n"
    "  --flip P --drop P --duplicate P  probability of each, for every byte to the host\n"
    "  --unplug AT:FOR    seconds since the first scan; may be repeated, in order\n"
    "  --reset AT         the board restarts; may be repeated, in order\n"
    "  --no-reset-on-open the board goes on when the host opens the port\n"
    "  --link PATH        a fixed name for the terminal\n"
    "  --log FILE         every byte sent, and its fate (0 whole, 1 flipped, 2 dropped, 3 duplicated)\n"
    "  --stop-after T     seconds of board time\n"
    "Prints 'port NAME'; at the end, on the error stream, figures as one line of JSON.\n";

enum { OPT_FIRMWARE = 256, OPT_TRUTH, OPT_ROW, OPT_COLUMN, OPT_LOAD, OPT_SETTLE, OPT_NOISE, OPT_MEMORY, OPT_SEED, OPT_LOOP, OPT_REAL_TIME,
       OPT_FLIP, OPT_DROP, OPT_DUPLICATE, OPT_UNPLUG, OPT_RESET, OPT_NO_RESET, OPT_LINK, OPT_LOG, OPT_STOP };

static const struct option options[] = {
    {"firmware", 1, 0, OPT_FIRMWARE}, {"truth", 1, 0, OPT_TRUTH}, {"row-ohm", 1, 0, OPT_ROW},
    {"column-ohm", 1, 0, OPT_COLUMN}, {"load-ohm", 1, 0, OPT_LOAD}, {"settle-us", 1, 0, OPT_SETTLE},
    {"noise-lsb", 1, 0, OPT_NOISE}, {"memory", 1, 0, OPT_MEMORY},
    {"seed", 1, 0, OPT_SEED}, {"loop", 0, 0, OPT_LOOP}, {"real-time", 0, 0, OPT_REAL_TIME}, {"flip", 1, 0, OPT_FLIP},
    {"drop", 1, 0, OPT_DROP}, {"duplicate", 1, 0, OPT_DUPLICATE}, {"unplug", 1, 0, OPT_UNPLUG},
    {"reset", 1, 0, OPT_RESET}, {"no-reset-on-open", 0, 0, OPT_NO_RESET}, {"link", 1, 0, OPT_LINK},
    {"log", 1, 0, OPT_LOG}, {"stop-after", 1, 0, OPT_STOP}, {0, 0, 0, 0}};

typedef struct {
    const char *firmware, *truth;
    outage_t outages[MOST_UNPLUGGED];
    int outage_count;
    double stop_after_s;
} plan_t;

static void add_outage(plan_t *plan, const char *text) {
    char *end;
    if (plan->outage_count == MOST_UNPLUGGED) return;
    outage_t *outage = &plan->outages[plan->outage_count++];
    outage->at_s = strtod(text, &end);
    outage->for_s = *end == ':' ? strtod(end + 1, 0) : -1; /* -1: a reset */
}

static void parse(int count, char **words, bench_t *bench, plan_t *plan) {
    int option;
    while ((option = getopt_long(count, words, "", options, 0)) != -1) switch (option) {
            case OPT_FIRMWARE: plan->firmware = optarg; break;
            case OPT_TRUTH: plan->truth = optarg; break;
            case OPT_ROW: parse_ohm(optarg, bench->panel.row_ohm); break;
            case OPT_COLUMN: parse_ohm(optarg, bench->panel.column_ohm); break;
            case OPT_LOAD: parse_ohm(optarg, bench->panel.load_ohm); break;
            case OPT_MEMORY: bench->panel.memory = atof(optarg); break;
            case OPT_SETTLE: bench->panel.settle_s = 1e-6 * atof(optarg); break;
            case OPT_NOISE: bench->panel.noise_lsb = atof(optarg); break;
            case OPT_SEED:
                bench->panel.random_state = strtoull(optarg, 0, 10);
                bench->line.random_state = ~bench->panel.random_state;
                break;
            case OPT_LOOP: bench->panel.loop = 1; break;
            case OPT_REAL_TIME: bench->line.real_time = 1; break;
            case OPT_FLIP: bench->line.flip = atof(optarg); break;
            case OPT_DROP: bench->line.drop = atof(optarg); break;
            case OPT_DUPLICATE: bench->line.duplicate = atof(optarg); break;
            case OPT_UNPLUG:
            case OPT_RESET: add_outage(plan, optarg); break;
            case OPT_NO_RESET: bench->reset_on_open = 0; break;
            case OPT_LINK: bench->line.link = optarg; break;
            case OPT_LOG: bench->line.log = fopen(optarg, "wb"); break;
            case OPT_STOP: plan->stop_after_s = atof(optarg); break;
            default: fputs(usage, stderr); exit(2);
        }
    if (!plan->firmware || !plan->truth) {
        fputs(usage, stderr);
        exit(2);
    }
}

static void bench_run(bench_t *bench, const plan_t *plan, FILE *console) {
    double began_s = wall_s();
    int outage = 0;
    avr_cycle_count_t pumped = 0;
    while (!quit) {
        int state = avr_run(bench->avr);
        if (state == cpu_Done || state == cpu_Crashed) break;
        if (bench->avr->cycle - pumped < PUMP_CYCLES) continue;
        pumped = bench->avr->cycle;
        bench_pump(bench);
        double now_s = board_s(bench);
        if (outage < plan->outage_count && bench->first_s >= 0 && panel_s(bench) >= plan->outages[outage].at_s) {
            double seconds = plan->outages[outage++].for_s;
            if (seconds < 0)
                bench_reset(bench);
            else
                bench_unplug(bench, seconds, console);
        }
        if (plan->stop_after_s > 0 && now_s >= plan->stop_after_s) break;
        if (bench->line.real_time) nap(now_s + bench->away_s - (wall_s() - began_s));
    }
    double seconds = wall_s() - began_s;
    fprintf(stderr,
            "{\"board_s\": %.6f, \"wall_s\": %.3f, \"bytes\": %lu, \"flipped\": %lu, \"dropped\": %lu, \"duplicated\": %lu, "
            "\"overrun\": %lu, \"conversions\": %lu, \"longest_scan_us\": %.1f}\n",
            board_s(bench), seconds, bench->line.sent, bench->line.flipped, bench->line.dropped, bench->line.duplicated,
            bench->line.overrun, bench->conversions, 1e6 * bench->longest_scan_s);
}

int main(int count, char **words) {
    static bench_t bench;
    static plan_t plan;
    for (int line = 0; line < 16; ++line) {
        bench.panel.row_ohm[line] = bench.panel.column_ohm[line] = 70;
        bench.panel.load_ohm[line] = LAMPEST_LOAD_MILLIOHM / 1000.0;
    }
    bench.panel.settle_s = 2e-6;
    bench.panel.noise_lsb = 0.7;
    bench.panel.random_state = 1;
    bench.line.random_state = ~UINT64_C(1);
    bench.reset_on_open = 1;
    bench.first_s = -1;
    parse(count, words, &bench, &plan);
    panel_read(&bench.panel, plan.truth);
    /* simavr talks on the standard output; keep that for ourselves. */
    FILE *console = fdopen(dup(STDOUT_FILENO), "w");
    if (!console || !freopen("/dev/null", "w", stdout)) return 1;
    struct sigaction action = {.sa_handler = on_signal};
    sigaction(SIGINT, &action, 0);
    sigaction(SIGTERM, &action, 0);
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    bench_build(&bench, plan.firmware);
    line_plug(&bench.line);
    fprintf(console, "port %s\n", bench.line.name);
    fflush(console);
    bench_run(&bench, &plan, console);
    line_unplug(&bench.line);
    if (bench.line.log) fclose(bench.line.log);
    return 0;
}
