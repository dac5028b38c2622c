#include "network.h"

#include "arithmetic.h"

/* out (m x n) = A b, b (k x n), added to out if `add`. A's rows are `row` numbers apart, its columns `step`.
 *
 * Two rows of A with five, four, or one column of b at once stay in registers: seven loads for ten products. */
static void multiply_strided(const float *a, unsigned row, unsigned step, const float *b, float *out, unsigned m,
                             unsigned k, unsigned n, bool add) {
    for (unsigned i = 0; i < m; i += 2, a += 2 * row, out += 2 * n) {
        const bool pair = i + 1 < m;
        const unsigned second = pair ? row : 0;
        float *upper = out, *lower = pair ? out + n : out;
        for (unsigned l = 0; l < n;) {
            const float *left = a, *right = b + l, *const end = right + k * n;
            if (n - l >= 4) {
                const bool five = n - l == 5 || n - l >= 10 || n - l == 9;
                float x0 = 0, x1 = 0, x2 = 0, x3 = 0, x4 = 0, y0 = 0, y1 = 0, y2 = 0, y3 = 0, y4 = 0;
                if (add) {
                    x0 = upper[l], x1 = upper[l + 1], x2 = upper[l + 2], x3 = upper[l + 3];
                    y0 = lower[l], y1 = lower[l + 1], y2 = lower[l + 2], y3 = lower[l + 3];
                    if (five) x4 = upper[l + 4], y4 = lower[l + 4];
                }
                if (five) {
                    for (; right != end; left += step, right += n) {
                        const float f = left[0], s = left[second];
                        const float b0 = right[0], b1 = right[1], b2 = right[2], b3 = right[3], b4 = right[4];
                        x0 = FUSED(f, b0, x0), x1 = FUSED(f, b1, x1), x2 = FUSED(f, b2, x2), x3 = FUSED(f, b3, x3);
                        y0 = FUSED(s, b0, y0), y1 = FUSED(s, b1, y1), y2 = FUSED(s, b2, y2), y3 = FUSED(s, b3, y3);
                        x4 = FUSED(f, b4, x4), y4 = FUSED(s, b4, y4);
                    }
                } else {
                    for (; right != end; left += step, right += n) {
                        const float f = left[0], s = left[second];
                        const float b0 = right[0], b1 = right[1], b2 = right[2], b3 = right[3];
                        x0 = FUSED(f, b0, x0), x1 = FUSED(f, b1, x1), x2 = FUSED(f, b2, x2), x3 = FUSED(f, b3, x3);
                        y0 = FUSED(s, b0, y0), y1 = FUSED(s, b1, y1), y2 = FUSED(s, b2, y2), y3 = FUSED(s, b3, y3);
                    }
                }
                lower[l] = y0, lower[l + 1] = y1, lower[l + 2] = y2, lower[l + 3] = y3;
                upper[l] = x0, upper[l + 1] = x1, upper[l + 2] = x2, upper[l + 3] = x3;
                if (five) lower[l + 4] = y4, upper[l + 4] = x4;
                l += five ? 5 : 4;
            } else {
                float x = add ? upper[l] : 0, y = add ? lower[l] : 0;
                for (; right != end; left += step, right += n) x = FUSED(left[0], *right, x), y = FUSED(left[second], *right, y);
                lower[l] = y, upper[l] = x;
                l++;
            }
        }
    }
}

/* out (m x n) = a (m x k) b (k x n), added to out if `add`. */
static void multiply(const float *a, const float *b, float *out, uint8_t m, uint8_t k, uint8_t n, bool add) {
    multiply_strided(a, k, 1, b, out, m, k, n, add);
}

/* out (n x n) = a' b of two matrices m x n. */
static void multiply_transposed(const float *a, const float *b, float *out, uint8_t m, uint8_t n) {
    multiply_strided(a, 1, n, b, out, n, m, n, false);
}

bool invert(float *s, float *excess, uint8_t n) {
    for (uint8_t p = 0; p < n; p++) {
        float *pivot_row = s + p * n;
        float pivot = excess[p];
        for (uint8_t k = p + 1; k < n; k++) pivot -= pivot_row[k];
        if (!(pivot > 0) || !isfinite(pivot)) return false;
        const float scale = 1 / pivot;
        for (uint8_t i = 0; i < n; i++) {
            if (i == p) continue;
            float *row = s + i * n;
            const float factor = row[p] * scale;
            for (uint8_t k = 0; k < n; k++) row[k] = FUSED(-factor, pivot_row[k], row[k]);
            row[p] = -factor;
            if (i > p) excess[i] = FUSED(-factor, excess[p], excess[i]);
        }
        for (uint8_t k = 0; k < n; k++) pivot_row[k] *= scale;
        pivot_row[p] = scale;
    }
    return true;
}

/* Ties of two-point readings: the line of the shorter side with the largest conductance is at ground. */
static void ground_one_line(network *net) {
    const uint8_t m = net->m, n = net->n;
    float largest = 0;
    uint8_t ground = 0;
    for (uint8_t k = 0; k < n; k++) {
        float sum = 0;
        for (uint8_t i = 0; i < m; i++) sum += net->conductance[i * n + k];
        if (sum > largest) largest = sum, ground = k;
    }
    memset(net->tie, 0, (m + n) * sizeof(float));
    net->tie[m + ground] = largest;
}

bool network_solve(network *net) {
    const uint8_t m = net->m, n = net->n;
    if (net->floats) ground_one_line(net);
    for (uint8_t i = 0; i < m; i++) {
        const float *g = net->conductance + i * n;
        float sum = net->tie[i];
        for (uint8_t k = 0; k < n; k++) sum += g[k];
        if (!(sum > 0) || !isfinite(sum)) return false;
        net->total[i] = sum;
        const float inverse = 1 / sum;
        for (uint8_t k = 0; k < n; k++) net->share[i * n + k] = g[k] * inverse;
    }
    /* S by what its rows have off the diagonal, -G'H, and by what leads to ground. */
    multiply_transposed(net->share, net->conductance, net->inverse, m, n);
    for (uint16_t entry = 0; entry < n * n; entry++) net->inverse[entry] = -net->inverse[entry];
    float *const to_ground = net->x_short;
    for (uint8_t k = 0; k < n; k++) {
        to_ground[k] = net->tie[m + k];
        for (uint8_t i = 0; i < m; i++) to_ground[k] += net->share[i * n + k] * net->tie[i];
    }
    if (!invert(net->inverse, to_ground, n)) return false;
    multiply(net->share, net->inverse, net->mutual, m, n, n, false);
    for (uint8_t i = 0; i < m; i++) {
        float own = 1 / net->total[i];
        for (uint8_t k = 0; k < n; k++) own += net->share[i * n + k] * net->mutual[i * n + k];
        net->own_long[i] = own;
    }
    return true;
}

void network_readings(network *net, float *reading) {
    const uint8_t m = net->m, n = net->n;
    const lampest_constants *c = net->constants;
    for (uint8_t i = 0; i < m; i++) {
        for (uint8_t k = 0; k < n; k++) {
            const uint16_t cell = i * n + k;
            const float in = net->own_long[i], out = net->inverse[k * n + k], mutual = net->mutual[cell];
            if (net->floats) {
                reading[cell] = in + out - 2 * mutual;
                continue;
            }
            const uint8_t d = net->long_driven ? i : k, s = net->long_driven ? k : i;
            const float driven = net->long_driven ? in : out, sensed = net->long_driven ? out : in;
            const float path = c->drive[d] + c->release[d] * driven, loaded = 1 + c->load[s] * sensed;
            const float both = c->release[d] * c->load[s];
            const float scale = 1 / (path * loaded - both * mutual * mutual);
            const float y = c->gain[s] * mutual * scale;
            reading[cell] = y;
            const float to_driven = -y * scale * c->release[d] * loaded, to_sensed = -y * scale * c->load[s] * path;
            net->slope_long[cell] = net->long_driven ? to_driven : to_sensed;
            net->slope_short[cell] = net->long_driven ? to_sensed : to_driven;
            net->slope_mutual[cell] = c->gain[s] * scale + 2 * y * scale * both * mutual;
        }
    }
}

void network_own_response(const network *net, float *response) {
    const uint8_t m = net->m, n = net->n;
    for (uint8_t i = 0; i < m; i++) {
        for (uint8_t k = 0; k < n; k++) {
            const uint16_t cell = i * n + k;
            const float a = net->own_long[i] - net->mutual[cell], b = net->inverse[k * n + k] - net->mutual[cell];
            const float across = net->floats ? (a + b) * (a + b)
                                             : net->slope_long[cell] * a * a + net->slope_short[cell] * b * b -
                                                   net->slope_mutual[cell] * a * b;
            response[cell] = net->conductance[cell] * across;
        }
    }
}

/* Z X Z for X = [diag(x_long), X; X', diag(x_short)] with X in net->middle, which is lost: `mutual_part` gets the
 * mutual part, x_long and x_short the diagonals.
 *
 * Z = [diag(1/a), 0; 0, 0] + [H; 1] S^-1 [H', 1]. With Q = diag(1/a) (x_long H + X) and
 * C = x_short + H'Y + Y'H, Y = x_long H / 2 + X, the mutual part is (Q + H S^-1 C) S^-1. */
static void sandwich(network *net, float *mutual_part) {
    const uint8_t m = net->m, n = net->n;
    float *x = net->middle, *c = net->small, *f = net->small2;
    for (uint8_t i = 0; i < m; i++) {
        const float half = 0.5f * net->x_long[i];
        for (uint8_t k = 0; k < n; k++) x[i * n + k] += half * net->share[i * n + k];
    }
    multiply_transposed(net->share, x, c, m, n);
    for (uint8_t k = 0; k < n; k++) {
        for (uint8_t l = 0; l <= k; l++) {
            const float sum = c[k * n + l] + c[l * n + k];
            c[k * n + l] = c[l * n + k] = sum;
        }
        c[k * n + k] += net->x_short[k];
    }
    multiply(c, net->inverse, f, n, n, n, false); /* C S^-1 */
    for (uint8_t k = 0; k < n; k++) {
        float sum = 0;
        for (uint8_t l = 0; l < n; l++) sum += net->inverse[k * n + l] * f[l * n + k];
        net->x_short[k] = sum;
    }
    /* Q in place of Y, then Q + (H S^-1) C, whose own diagonal is known before the last product with S^-1. */
    float *sum = net->middle;
    for (uint8_t i = 0; i < m; i++) {
        const float inverse = 1 / net->total[i], half = 0.5f * net->x_long[i];
        const float *share = net->share + i * n, *mutual = net->mutual + i * n;
        float own = net->x_long[i] * inverse * inverse;
        for (uint8_t k = 0; k < n; k++) {
            const float q = inverse * (sum[i * n + k] + half * share[k]);
            sum[i * n + k] = q;
            own += q * mutual[k];
        }
        net->x_long[i] = own;
    }
    multiply(net->mutual, c, sum, m, n, n, true);
    for (uint8_t i = 0; i < m; i++) {
        float own = 0;
        for (uint8_t k = 0; k < n; k++) own += sum[i * n + k] * net->mutual[i * n + k];
        net->x_long[i] += own;
    }
    multiply(sum, net->inverse, mutual_part, m, n, n, false);
}

/* X of changed cells, with conductances q: the Laplacian of q. */
static void put_laplacian(network *net, const float *scale, const float *values) {
    const uint8_t m = net->m, n = net->n;
    memset(net->x_short, 0, n * sizeof(float));
    for (uint8_t i = 0; i < m; i++) {
        float sum = 0;
        for (uint8_t k = 0; k < n; k++) {
            const uint16_t cell = i * n + k;
            const float q = scale ? scale[cell] * values[cell] : values[cell];
            sum += q;
            net->x_short[k] += q;
            net->middle[cell] = -q;
        }
        net->x_long[i] = sum;
    }
}

/* b' K b over each cell, b its +1 and -1, of a K that `sandwich` left; times `scale` if there is one. */
static void take_across(const network *net, float *mutual_part, const float *scale) {
    const uint8_t m = net->m, n = net->n;
    for (uint8_t i = 0; i < m; i++) {
        for (uint8_t k = 0; k < n; k++) {
            const uint16_t cell = i * n + k;
            const float across = net->x_long[i] + net->x_short[k] - 2 * mutual_part[cell];
            mutual_part[cell] = scale ? scale[cell] * across : across;
        }
    }
}

void network_forward(network *net, const float *p, float *reading) {
    const uint8_t m = net->m, n = net->n;
    put_laplacian(net, net->conductance, p); /* dZ = Z L(g p) Z, as dg = -g du */
    sandwich(net, reading);
    if (net->floats) {
        take_across(net, reading, NULL);
        return;
    }
    for (uint8_t i = 0; i < m; i++) {
        for (uint8_t k = 0; k < n; k++) {
            const uint16_t cell = i * n + k;
            reading[cell] = net->slope_long[cell] * net->x_long[i] + net->slope_short[cell] * net->x_short[k] +
                            net->slope_mutual[cell] * reading[cell];
        }
    }
}

void network_adjoint(network *net, const float *w, float *cells) {
    const uint8_t m = net->m, n = net->n;
    if (net->floats) {
        put_laplacian(net, NULL, w); /* two-point readings: their slopes are those of a Laplacian */
    } else {
        memset(net->x_short, 0, n * sizeof(float));
        for (uint8_t i = 0; i < m; i++) {
            float sum = 0;
            for (uint8_t k = 0; k < n; k++) {
                const uint16_t cell = i * n + k;
                sum += net->slope_long[cell] * w[cell];
                net->x_short[k] += net->slope_short[cell] * w[cell];
                net->middle[cell] = 0.5f * net->slope_mutual[cell] * w[cell];
            }
            net->x_long[i] = sum;
        }
    }
    sandwich(net, cells);
    take_across(net, cells, net->conductance);
}

/* dy/dg of a reading by a cell whose ends have, towards the reading's long and short line, potential differences u, v. */
INLINE float response_to(const network *net, uint16_t cell, float u, float v) {
    if (net->floats) return (u - v) * (u - v);
    return net->slope_long[cell] * u * u + net->slope_short[cell] * v * v + net->slope_mutual[cell] * u * v;
}

void network_line_responses(const network *net, const float *weight, float *s) {
    const uint8_t m = net->m, n = net->n;
    const float *g = net->conductance, *z = net->mutual;
    memset(s, 0, (m + n) * sizeof(float));
    float *const column = net->small; /* conductances of the short lines */
    memset(column, 0, n * sizeof(float));
    for (uint16_t cell = 0, k = 0; cell < m * n; cell++, k = k + 1 < n ? k + 1 : 0) column[k] += g[cell];
    for (uint8_t i = 0; i < m; i++) {
        const float own = net->own_long[i];
        float *const beta = net->x_short; /* sums over the other long lines */
        memset(beta, 0, n * sizeof(float));
        for (uint8_t other = 0; other < m; other++) {
            if (other == i) continue;
            float between = 0; /* Z of the two long lines */
            for (uint8_t k = 0; k < n; k++) between = FUSED(net->share[i * n + k], z[other * n + k], between);
            for (uint8_t k = 0; k < n; k++) {
                const float u = between - z[i * n + k], v = z[other * n + k] - net->inverse[k * n + k];
                beta[k] = FUSED(g[other * n + k], response_to(net, i * n + k, u, v), beta[k]);
            }
        }
        for (uint8_t k = 0; k < n; k++) {
            const uint16_t cell = i * n + k;
            float alpha = 0, along_i = 0, along_k = column[k] - g[cell];
            for (uint8_t other = 0; other < n; other++) {
                if (other == k) continue;
                const float u = own - z[i * n + other], v = z[cell] - net->inverse[k * n + other];
                alpha = FUSED(g[i * n + other], response_to(net, cell, u, v), alpha);
                along_i += g[i * n + other];
            }
            const float a = along_i > 0 ? alpha / along_i : 0, b = along_k > 0 ? beta[k] / along_k : 0;
            const float w = weight[cell];
            s[i] += w * a * a;
            s[m + k] += w * b * b;
        }
    }
}
