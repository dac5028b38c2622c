/* Star-mesh elimination: remove node s by w_ab += w_as w_sb / sum_c w_sc until only two nodes are left.
 * No subtraction occurs, so no digits are lost however far the cells are apart. */
#include "network.h"

#include <math.h>
#include <string.h>

double network_resistance(const double *cells, int rows, int columns, int row, int column) {
    double weight[NETWORK_MOST_LINES][NETWORK_MOST_LINES];
    int lines = rows + columns;
    memset(weight, 0, sizeof weight);
    for (int j = 0; j < rows; ++j)
        for (int k = 0; k < columns; ++k) weight[j][rows + k] = weight[rows + k][j] = 1 / cells[j * columns + k];
    for (int gone = 0; gone < lines; ++gone) {
        if (gone == row || gone == rows + column) continue;
        double total = 0;
        for (int c = 0; c < lines; ++c) total += weight[gone][c];
        if (total > 0)
            for (int a = 0; a < lines; ++a)
                for (int b = 0; b < lines; ++b)
                    if (a != b && a != gone && b != gone) weight[a][b] += weight[a][gone] * weight[gone][b] / total;
        for (int c = 0; c < lines; ++c) weight[gone][c] = weight[c][gone] = 0;
    }
    double conductance = weight[row][rows + column];
    return conductance > 0 ? 1 / conductance : INFINITY;
}
