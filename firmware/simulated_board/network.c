/* Star-mesh elimination: remove node s by w_ab += w_as w_sb / sum_c w_sc until only the nodes that matter are left.
 * No subtraction occurs, so no digits are lost however far the cells are apart. */
#include "network.h"

#include <math.h>
#include <string.h>

#define NODES (NETWORK_MOST_LINES + 2) /* rows, columns, supply, ground */

typedef double mesh_t[NODES][NODES]; /* conductances between nodes */

static void join(mesh_t weight, int one, int other, double ohm) {
    weight[one][other] = weight[other][one] = 1 / ohm;
}

static void join_cells(mesh_t weight, const double *cells, int rows, int columns) {
    memset(weight, 0, sizeof(mesh_t));
    for (int j = 0; j < rows; ++j)
        for (int k = 0; k < columns; ++k) join(weight, j, rows + k, cells[j * columns + k]);
}

static void remove_node(mesh_t weight, int gone, int nodes) {
    double total = 0;
    for (int c = 0; c < nodes; ++c) total += weight[gone][c];
    if (total > 0)
        for (int a = 0; a < nodes; ++a)
            for (int b = 0; b < nodes; ++b)
                if (a != b && a != gone && b != gone) weight[a][b] += weight[a][gone] * weight[gone][b] / total;
    for (int c = 0; c < nodes; ++c) weight[gone][c] = weight[c][gone] = 0;
}

double network_resistance(const double *cells, int rows, int columns, int row, int column) {
    mesh_t weight;
    int lines = rows + columns;
    join_cells(weight, cells, rows, columns);
    for (int gone = 0; gone < lines; ++gone)
        if (gone != row && gone != rows + column) remove_node(weight, gone, lines);
    double conductance = weight[row][rows + column];
    return conductance > 0 ? 1 / conductance : INFINITY;
}

double network_share(const double *cells, int rows, int columns, int row, int column, double drive_ohm,
                     const double *load_ohm) {
    mesh_t weight;
    int lines = rows + columns, supply = lines, ground = lines + 1, sensed = rows + column;
    join_cells(weight, cells, rows, columns);
    join(weight, row, supply, drive_ohm);
    for (int k = 0; k < columns; ++k) join(weight, rows + k, ground, load_ohm[k]);
    for (int gone = 0; gone < lines; ++gone)
        if (gone != sensed) remove_node(weight, gone, lines + 2);
    return weight[sensed][supply] / (weight[sensed][supply] + weight[sensed][ground]);
}
