/* The yardstick of benchmarks/smc.py: runs of exact steps one after another, scalar C, one thread.
 *
 * Input (stdin, text): runs seed x0 barrier steps first, then for each step: decay pull shift sigma bridge enters mu
 * spread; `first` is the step from which the barrier is watched (steps: only at the end). Output: hits and seconds.
 * Normals by Marsaglia & Tsang's ziggurat (2000) on xoshiro256+ (Blackman & Vigna 2018).
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

static uint64_t s[4];
static uint32_t kn[128];
static double wn[128], fn[128];

static inline uint64_t rotl(uint64_t x, int k) { return (x << k) | (x >> (64 - k)); }

static inline uint64_t next(void) {
    uint64_t result = s[0] + s[3], t = s[1] << 17;
    s[2] ^= s[0]; s[3] ^= s[1]; s[1] ^= s[2]; s[0] ^= s[3]; s[2] ^= t; s[3] = rotl(s[3], 45);
    return result;
}

static inline double uniform(void) { return ((next() >> 11) + 0.5) * 0x1.0p-53; }

static void tables(void) {
    const double m = 2147483648.0;
    double d = 3.442619855899, t = d, v = 9.91256303526217e-3, q = v / exp(-0.5 * d * d);
    kn[0] = (uint32_t)(d / q * m); kn[1] = 0;
    wn[0] = q / m; wn[127] = d / m; fn[0] = 1.0; fn[127] = exp(-0.5 * d * d);
    for (int i = 126; i >= 1; i--) {
        d = sqrt(-2.0 * log(v / d + exp(-0.5 * d * d)));
        kn[i + 1] = (uint32_t)(d / t * m); t = d; fn[i] = exp(-0.5 * d * d); wn[i] = d / m;
    }
}

static double rare_normal(int32_t h, uint32_t i) {
    const double r = 3.442619855899;
    for (;;) {
        double x = h * wn[i], y;
        if (i == 0) {
            do { x = -log(uniform()) / r; y = -log(uniform()); } while (y + y < x * x);
            return h > 0 ? r + x : -r - x;
        }
        if (fn[i] + uniform() * (fn[i - 1] - fn[i]) < exp(-0.5 * x * x)) return x;
        uint64_t u = next() >> 20; h = (int32_t)(u & 0xffffffff); i = (uint32_t)(u >> 32) & 127;
        if ((uint32_t)llabs((long long)h) < kn[i]) return h * wn[i];
    }
}

static inline double normal(void) {
    uint64_t u = next() >> 20;
    int32_t h = (int32_t)(u & 0xffffffff); uint32_t i = (uint32_t)(u >> 32) & 127;
    return (uint32_t)llabs((long long)h) < kn[i] ? h * wn[i] : rare_normal(h, i);
}

typedef struct { double decay, pull, shift, sigma, bridge, enters, mu, spread; } step;

int main(void) {
    long runs, n, first, hits = 0; unsigned long seed; double x0, b;
    if (scanf("%ld %lu %lf %lf %ld %ld", &runs, &seed, &x0, &b, &n, &first) != 6) return 2;
    step *plan = malloc(sizeof(step) * (size_t)n);
    for (long k = 0; k < n; k++) {
        step *p = plan + k;
        if (scanf("%lf %lf %lf %lf %lf %lf %lf %lf", &p->decay, &p->pull, &p->shift, &p->sigma, &p->bridge,
                  &p->enters, &p->mu, &p->spread) != 8) return 2;
    }
    for (int i = 0; i < 4; i++) {
        uint64_t z = (seed += 0x9e3779b97f4a7c15); z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9;
        z = (z ^ (z >> 27)) * 0x94d049bb133111eb; s[i] = z ^ (z >> 31);
    }
    tables();
    clock_t begin = clock();
    for (long run = 0; run < runs; run++) {
        double x = x0, m = 0.0, y;
        long k = 0;
        for (; k < n; k++) {
            const step *p = plan + k;
            if (p->enters != 0.0) m = p->mu + p->spread * normal();
            y = p->decay * x + p->pull * m + p->shift + p->sigma * normal();
            if (k >= first) {
                double product = (b - x) * (b - y);
                if (y >= b || (product < 20.0 * p->bridge && product < -0.5 * p->bridge * log(uniform()))) break;
            }
            x = y;
        }
        hits += first < n ? k < n : x >= b;
    }
    printf("%ld %.9f\n", hits, (double)(clock() - begin) / CLOCKS_PER_SEC);
    free(plan);
    return 0;
}
