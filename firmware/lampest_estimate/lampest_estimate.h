/* The estimate of cells on a microcontroller: C99, single precision, no allocation, no library but math.h, no globals.
 *
 * A resistive matrix has crosstalk: each reading depends on all cells. This library minimises on the board what lampest
 * minimises on a computer,
 *
 *     cost(u) = sum_i rho((y_i(u) - measured_i) / sigma_i) + sum_terms weight rho(residual(u)),   u = ln(cell in ohm),
 *
 * by Gauss-Newton steps with conjugate gradients. A frame begins at the estimate of the frame before it. The constants
 * of a panel are written by `lampest export RESULTS --to c` as a header, which also says how much memory they need:
 *
 *     static lampest_panel panel = {&panel_constants};
 *     static float memory[PANEL_MEMORY];
 *
 *     lampest_begin(&panel, memory);
 *     lampest_baseline(&panel, sums);                                   // unloaded; as often as wanted
 *     lampest_status status = lampest_frame(&panel, sums, log_change);  // ln(r / r unloaded), row by row
 *     lampest_follow(&panel);                                           // where loads come and go, and the film drifts
 *
 * Only lampest_panel is written to, so that several panels can be estimated side by side.
 */
#ifndef LAMPEST_ESTIMATE_H
#define LAMPEST_ESTIMATE_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* 10,000 major + 100 minor + patch, the version of library.json. Constants of another version are refused. */
#define LAMPEST_ESTIMATE_VERSION 200

#define LAMPEST_MAX_LINES 64 /* of a side; line numbers and vectors over the lines are that long at most */

/* A sum that no converter gives, for a reading that is missing. Any sum above `top_sum` counts as missing. */
#define LAMPEST_MISSING 0xFFFFFFFFul

/* Floats of the working memory. `driven` is 1 for circuits with driven lines, `relative` where a term compares with the
 * previous frame; else 0. */
#define LAMPEST_MEMORY(rows, columns, driven, relative)                                                     \
    ((16 + 3 * (driven) + (relative)) * (rows) * (columns) +                                                \
     4 * ((rows) < (columns) ? (rows) * (rows) : (columns) * (columns)) + 6 * ((rows) + (columns)) + 2)

typedef enum { LAMPEST_SQUARED, LAMPEST_HUBER, LAMPEST_STUDENT } lampest_loss;

/* What a penalty compares: v(u) of each cell. */
typedef enum {
    LAMPEST_LOG,            /* u */
    LAMPEST_OHM,            /* r in ohm */
    LAMPEST_CHANGE,         /* 100 (r - r0) / r0 in percent, r0 the previous frame */
    LAMPEST_LOG_OF_BASELINE,/* 100 ln(r / r0) in percent, r0 the baseline */
    LAMPEST_LOG_OF_PREVIOUS /* 100 ln(r / r0) in percent, r0 the previous frame */
} lampest_quantity;

/* How it compares: the values themselves, steps between neighbours, or central differences along rows and columns. */
typedef enum { LAMPEST_VALUES, LAMPEST_STEPS, LAMPEST_CENTRAL } lampest_difference;

typedef struct {
    lampest_quantity quantity;
    lampest_difference difference;
    lampest_loss loss;
    float corner; /* of the loss, in the unit of the residual */
    float weight;
} lampest_term;

/* Neighbouring cells of a panel with an outline, by their numbers along the longer side, and their distance in pitches. */
typedef struct {
    uint16_t first, second;
    float distance;
} lampest_pair;

/* Constants of one estimator on one panel. Arrays over cells are row by row, as readings are. */
typedef struct {
    uint32_t version;      /* of the library that they were written for: LAMPEST_ESTIMATE_VERSION */
    uint8_t rows, columns;
    const uint8_t *present; /* 1 for each cell that the panel has; NULL: all */
    const lampest_pair *pairs;
    uint16_t pair_count; /* 0: all neighbours of the full rectangle */

    /* Circuit. Driven lines: V_ij = source_i gain_j Z_ij / ((drive_i + release_i Z_ii)(1 + load_j Z_jj)
     * - release_i load_j Z_ij^2), Z the impedance of all lines with their ties. Else R_ij = Z_ii + Z_jj - 2 Z_ij. */
    bool driven;           /* false: two-point readings, every other line floats */
    bool rows_driven;
    const float *tie;      /* rows + columns, siemens: what idle lines have to ground; NULL for two-point readings */
    const float *drive;    /* driven lines, ohm: Rd */
    const float *release;  /* driven lines: 1 - Rd/Rp, Rp that of an idle line */
    const float *load;     /* sensed lines, siemens: 1/Rs - 1/Rq, Rq that of an idle line */
    const float *gain;     /* sensed lines, volt: supply times the share of the line's voltage at the converter */

    /* Converter: sums of `readings` codes. */
    uint32_t top_sum;      /* largest possible sum */
    uint32_t low_sum, high_sum; /* sums below and above are bounds, at the edges of this range */
    float volt_per_sum, volt_at_zero;
    float supply_volt;
    bool mirrored;         /* the network's voltage is the supply less the converter's */
    float reference_ohm;   /* two-point: of the divider, measured across it if `across_reference` */
    bool across_reference;
    float ohm_scale, shunt_siemens; /* two-point: what the converter's input changes; 1 and 0 without */
    const float *series;   /* two-point: rows + columns, ohm, in series with a reading; NULL: none */
    const float *sigma_volt;/* standard deviation at the converter, volt; one for each reading, or one */
    uint16_t sigma_count;
    float plain_sigma;     /* standard deviation of each reading in its own unit where the misfit is plain; else 0 */

    lampest_loss data_loss;
    float data_corner;
    const lampest_term *terms;
    uint8_t term_count;
    float least_ohm, largest_ohm; /* bounds of cells; two-point readings also bound their cells: R <= r <= R^2/sigma */
    bool native_bounds;
    const float *baseline; /* cells at rest, ohm */
    float loaded_limit;    /* a cell that lies further below the others than this, in ln r, is no cell at rest */
    float follow;          /* unloaded frames in which the baseline makes up 1 - 1/e of a drift */

    /* Budget of a frame. */
    uint8_t steps;
    uint8_t products;      /* conjugate-gradient iterations of a step */
    float within;          /* a frame has settled at this deviation from the optimum, in standard deviations */
} lampest_constants;

typedef enum {
    LAMPEST_FINE,
    LAMPEST_BAD_CONSTANTS, /* a number is no number, or out of range: nothing is estimated */
    LAMPEST_TOO_FEW,       /* most readings are missing, or too few are values and not bounds: the estimate stays */
    LAMPEST_UNDER_LOAD,    /* a baseline of a panel that is touched: the old one stays */
    LAMPEST_FAILED,        /* the arithmetic broke down: the estimate stays */
    LAMPEST_OTHER_VERSION  /* the constants were written for another version of this library */
} lampest_outcome;

typedef struct {
    lampest_outcome outcome;
    bool settled;       /* the decrease that is left is below the budget's `within` */
    uint8_t steps;      /* that were taken */
    uint16_t products;  /* work spent: pairs of products with J and its transpose, a network solve counts as one */
    uint16_t saturated; /* readings at the ends of the converter's range */
    uint16_t missing;   /* readings that are missing */
    uint8_t dead_line;  /* 1 + number of a line without any value, rows before columns; 0: none */
    float left;         /* predicted decrease of the cost that is left: squared standard deviations, over all cells */
} lampest_status;

typedef struct {
    const lampest_constants *constants;
    /* All that follows is set by lampest_begin. */
    float *memory;
    bool ready;         /* the constants are sound */
    bool solved;        /* a frame or a baseline was estimated */
    bool settled;       /* the last frame has */
    bool at_baseline;   /* the next frame starts at the baseline instead of the estimate of the last one */
    uint8_t baselines;  /* unloaded frames that `lampest_baseline` took, at most 255 */
} lampest_panel;

/* Check the constants and start from their baseline. `memory` has the floats that the header declares. */
lampest_outcome lampest_begin(lampest_panel *panel, float *memory);

/* Take up an unloaded frame in the baseline: the first call replaces that of the constants, the next ones average, and later
 * ones follow a drift with the time constant `follow`. */
lampest_status lampest_baseline(lampest_panel *panel, const uint32_t *sums);

/* Let the baseline follow a drift, with the time constant `follow`: after frames that show no load, and have settled.
 *
 * A load lowers some cells, by more than `loaded_limit` below the others, and is never taken up. What changes all cells,
 * raises some, or stays below the limit is taken for drift. Returns whether the baseline moved. */
bool lampest_follow(lampest_panel *panel);

/* Estimate a frame. `log_change` gets ln(r / r unloaded) of all cells, row by row; 0 where there is no cell. */
lampest_status lampest_frame(lampest_panel *panel, const uint32_t *sums, float *log_change);

/* Cell of the present estimate in ohm. */
float lampest_cell(const lampest_panel *panel, uint8_t row, uint8_t column);

/* Standard deviation of ln r of one cell at the present estimate, from noise and penalties. It takes one solve of the
 * linear system, at most `products` products, so that the bars of a frame can be spread over many calls. Negative where
 * it is not known: before the first frame, without a cell, or where the cell is at a bound. */
float lampest_deviation(lampest_panel *panel, uint8_t row, uint8_t column, uint16_t products);

#ifdef __cplusplus
}
#endif

#endif
