#include "panel.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "pins.h"
#include "protocol.h"

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
    panel->known_frame = panel->row = panel->column = -1;
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

static double resting_volt(panel_t *panel, double time_s) {
    double supply = LAMPEST_SUPPLY_MILLIVOLT / 1000.0, reference = LAMPEST_REFERENCE_MILLIOHM / 1000.0;
    double resistance = INFINITY;
    int frame = frame_at(panel, time_s), cells = panel->rows * panel->columns;
    if (frame != panel->known_frame) {
        for (int cell = 0; cell < cells; ++cell)
            panel->resistance[cell] = network_resistance(panel->cells + (size_t)frame * (size_t)cells, panel->rows,
                                                         panel->columns, cell / panel->columns, cell % panel->columns);
        panel->known_frame = frame;
    }
    if (panel->row >= 0 && panel->row < panel->rows && panel->column >= 0 && panel->column < panel->columns)
        resistance = panel->resistance[panel->row * panel->columns + panel->column] + panel->row_ohm[panel->row] +
                     panel->column_ohm[panel->column];
    double across_reference = isinf(resistance) ? 0 : supply * reference / (resistance + reference);
    return LAMPEST_MEASURED_ACROSS == LAMPEST_ACROSS_REFERENCE ? across_reference : supply - across_reference;
}

static double volt_at(panel_t *panel, double time_s) {
    double volt = resting_volt(panel, time_s);
    if (panel->settle_s <= 0) return volt;
    return volt + (panel->volt_before - volt) * exp(-(time_s - panel->switched_s) / panel->settle_s);
}

void panel_select(panel_t *panel, int row, int column, double time_s) {
    double volt = volt_at(panel, time_s);
    panel->volt_before = volt;
    panel->switched_s = time_s;
    panel->row = row;
    panel->column = column;
}

int panel_code(panel_t *panel, double time_s) {
    double steps = volt_at(panel, time_s) * (1 << LAMPEST_ADC_BITS) / (LAMPEST_SUPPLY_MILLIVOLT / 1000.0);
    if (panel->noise_lsb > 0) steps += panel->noise_lsb * random_normal(&panel->random_state);
    int code = (int)floor(steps);
    int most = (1 << LAMPEST_ADC_BITS) - 1;
    return code < 0 ? 0 : code > most ? most : code;
}
