/* Arithmetic in single precision that gives the same bits on every processor that has a fused multiply-add, and on
 * computers, which emulate it: what runs on a board can be checked on a desk.
 *
 * Few conjugate gradients that have not converged carry a difference in the last bit to the third digit; therefore the
 * compiler must not choose by itself which products it fuses. */
#ifndef LAMPEST_ARITHMETIC_H
#define LAMPEST_ARITHMETIC_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

/* a b + c. Processors without a fused instruction, and compilers for 8 bits, take two operations. */
#if defined(__FP_FAST_FMAF) || defined(__ARM_FEATURE_FMA) || defined(__x86_64__) || defined(__aarch64__)
#define FUSED(a, b, c) fmaf(a, b, c)
#else
#define FUSED(a, b, c) ((a) * (b) + (c))
#endif

INLINE float larger(float a, float b) {
    return a > b ? a : b;
}

INLINE float smaller(float a, float b) {
    return a < b ? a : b;
}

/* e^x to 1e-7, for |x| < 87: 2^k with the nearest whole k, times the series of the rest, |rest| < 0.35. */
INLINE float exponential(float x) {
    x = x > 87 ? 87 : x < -87 ? -87 : x;
    const int32_t whole = (int32_t)(x * 1.44269504f + (x < 0 ? -0.5f : 0.5f));
    const float k = (float)whole;
    const float rest = FUSED(k, 2.12194440e-4f, FUSED(k, -0.693359375f, x));
    float series = 1.0f / 5040;
    series = FUSED(series, rest, 1.0f / 720);
    series = FUSED(series, rest, 1.0f / 120);
    series = FUSED(series, rest, 1.0f / 24);
    series = FUSED(series, rest, 1.0f / 6);
    series = FUSED(series, rest, 0.5f);
    series = FUSED(series, rest, 1.0f);
    series = FUSED(series, rest, 1.0f);
    const uint32_t bits = (uint32_t)(whole + 127) << 23;
    float power;
    memcpy(&power, &bits, sizeof power);
    return series * power;
}

/* ln x to 1e-7, for normal positive x: k ln 2 plus the series of 2 artanh((f - 1) / (f + 1)), f from 0.7 to 1.4. */
INLINE float logarithm(float x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    int32_t k = (int32_t)(bits >> 23) - 127;
    bits = (bits & 0x7FFFFF) | 0x3F800000;
    float f;
    memcpy(&f, &bits, sizeof f);
    if (f > 1.41421356f) f *= 0.5f, k++;
    const float s = (f - 1) / (f + 1), square = s * s;
    float series = 2.0f / 9;
    series = FUSED(series, square, 2.0f / 7);
    series = FUSED(series, square, 2.0f / 5);
    series = FUSED(series, square, 2.0f / 3);
    series = FUSED(series, square, 2.0f);
    return FUSED((float)k, 0.693147181f, s * series);
}

#endif
