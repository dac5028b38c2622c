#include "panel.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "pins.h"
#include "protocol.h"

#define LEAST_OHM 1e-6 /* of a channel that is said to have none: far below any contact */

double random_uniform(uint64_t *state) { /* splitmix64 */
    uint64_t mixed = (*state += 0x9E3779B97F4A7C15u);
    mixed = (mixed ^ mixed >> 30) * 0xBF58476D1CE4E5B9u;
    mixed = (mixed ^ mixed >> 27) * 0x94D049BB133111EBu;
    return (double)((mixed ^ mixed >> 31) >> 11) / 9007199254740992.0;
}

double random_normal(uint64_t *state) { /* Box and Muller */
    double radius = sqrt(-2 * log(1 - random_uniform(state)));
    return radius * cos(6.283185307179586 * random_uniform(state));
}

static void give_up(const char *path, const char *reason) {
    fprintf(stderr, "simulated_board: %s: %s\n", path, reason);
    exit(2);
}

void panel_read(panel_t *panel, const char *path) {
    FILE *file = fopen(path, "r");
    if (!file) give_up(path, "cannot be read");
    if (fscanf(file, "%d %d %d", &panel->frames, &panel->rows, &panel->columns) != 3 || panel->frames < 1 ||
        panel->rows < 1 || panel->rows > LAMPEST_MOST_ROWS || panel->columns < 1 || panel->columns > LAMPEST_MOST_COLUMNS)
        give_up(path, "must begin with frames, rows (1 to 16) and columns (1 to 16)");
    size_t cells = (size_t)panel->rows * (size_t)panel->columns;
    panel->time = malloc((size_t)panel->frames * sizeof(double));
    panel->cells = malloc((size_t)panel->frames * cells * sizeof(double));
    if (!panel->time || !panel->cells) give_up(path, "too large");
    for (int frame = 0; frame < panel->frames; ++frame) {
        if (fscanf(file, "%lf", &panel->time[frame]) != 1) give_up(path, "ends too early");
        for (size_t cell = 0; cell < cells; ++cell)
            if (fscanf(file, "%lf", &panel->cells[(size_t)frame * cells + cell]) != 1) give_up(path, "ends too early");
    }
    fclose(file);
    panel->known_frame = panel->row_before = panel->row = panel->column = -1;
}

static int frame_at(const panel_t *panel, double time_s) {
    /* A millisecond early, so that a scan which begins with a frame's time sees that frame from its first cell on. */
    double wanted = panel->time[0] + time_s + 1e-3;
    if (panel->loop && panel->frames > 1) {
        double span = (panel->time[panel->frames - 1] - panel->time[0]) * panel->frames / (panel->frames - 1);
        wanted = panel->time[0] + fmod(time_s + 1e-3, span);
    }
    int frame = panel->known_frame < 0 ? 0 : panel->known_frame;
    if (panel->time[frame] > wanted) frame = 0;
    while (frame + 1 < panel->frames && panel->time[frame + 1] <= wanted) ++frame;
    return frame;
}

static double two_point_volt(double resistance) {
    double supply = LAMPEST_SUPPLY_MILLIVOLT / 1000.0, reference = LAMPEST_REFERENCE_MILLIOHM / 1000.0;
    double across_reference = isinf(resistance) ? 0 : supply * reference / (resistance + reference);
    return LAMPEST_MEASURED_ACROSS == LAMPEST_ACROSS_REFERENCE ? across_reference : supply - across_reference;
}

static double solved_volt(const panel_t *panel, const double *cells, int row, int column) {
    if (LAMPEST_WIRING == LAMPEST_LOADED_COLUMNS)
        return LAMPEST_SUPPLY_MILLIVOLT / 1000.0 *
               network_share(cells, panel->rows, panel->columns, row, column, fmax(panel->row_ohm[row], LEAST_OHM),
                             panel->load_ohm);
    return two_point_volt(network_resistance(cells, panel->rows, panel->columns, row, column) + panel->row_ohm[row] +
                          panel->column_ohm[column]);
}

static double resting_volt(panel_t *panel, int row, int column, double time_s) {
    int frame = frame_at(panel, time_s), cells = panel->rows * panel->columns;
    if (frame != panel->known_frame) {
        for (int cell = 0; cell < cells; ++cell)
            panel->resting[cell] = solved_volt(panel, panel->cells + (size_t)frame * (size_t)cells,
                                               cell / panel->columns, cell % panel->columns);
        panel->known_frame = frame;
    }
    if (row >= 0 && row < panel->rows && column >= 0 && column < panel->columns)
        return panel->resting[row * panel->columns + column];
    return LAMPEST_WIRING == LAMPEST_LOADED_COLUMNS ? 0 : two_point_volt(INFINITY);
}

static double volt_at(panel_t *panel, double time_s) {
    double volt = resting_volt(panel, panel->row, panel->column, time_s);
    if (panel->settle_s <= 0) return volt;
    /* Loaded column lines settle each on their own, from what the row before gave them. */
    double before = LAMPEST_WIRING == LAMPEST_LOADED_COLUMNS
                        ? resting_volt(panel, panel->row_before, panel->column, time_s)
                        : panel->volt_before;
    return volt + (before - volt) * exp(-(time_s - panel->switched_s) / panel->settle_s);
}

void panel_select(panel_t *panel, int row, int column, double time_s) {
    double volt = volt_at(panel, time_s);
    panel->volt_before = volt;
    panel->switched_s = time_s;
    panel->row_before = panel->row;
    panel->row = row;
    panel->column = column;
}

void panel_sense(panel_t *panel, int column) { panel->column = column; }

int panel_code(panel_t *panel, double time_s) {
    double volt = volt_at(panel, time_s);
    panel->converted = volt += panel->memory * (panel->converted - volt);
    double steps = volt * (1 << LAMPEST_ADC_BITS) / (LAMPEST_SUPPLY_MILLIVOLT / 1000.0);
    if (panel->noise_lsb > 0) steps += panel->noise_lsb * random_normal(&panel->random_state);
    /* A converter rounds: its first transition is half a step above zero (data sheet). */
    int code = (int)floor(steps + 0.5);
    int most = (1 << LAMPEST_ADC_BITS) - 1;
    return code < 0 ? 0 : code > most ? most : code;
}
