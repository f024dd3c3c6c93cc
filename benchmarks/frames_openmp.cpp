// A pass over pixels, their samples 64 at a time: places, lookups and weights on vectors, and then the sum,
// a pixel of four channels at once. Compiled by frames_rivals.py; see `frames_problem.Given` for the arrays.
#include <algorithm>
#include <cmath>
#include <cstdint>

namespace {

constexpr int CHUNK = 64;
constexpr float UNIT = 1.0f / 16777216.0f;

struct Pass {
    const float *source, *pixels, *x, *y, *change, *weights, *d, *polynomial;
    const std::int32_t* version;
    const std::uint32_t* shift;
    float last, cutoff, within;
    int height, width, samples;
    std::int64_t count;
    float* out;
};

// The profile's radial density, up to a factor of all channels.
template <bool CUT>
inline float density(float r, float d, float cutoff) {
    const float slow = std::exp(r * (-1.0f / (3.0f * d)));
    const float whole = slow * (1.0f + slow * slow) / d;
    return CUT && r > cutoff * d ? 0.0f : whole;
}

// Cosine and sine of an angle in turns by Taylor's series, as C has no function of both for vectors.
inline void rotation(float turn, float& cosine, float& sine) {
    const int quarter = (int)(4.0f * turn + 0.5f);
    const float t = turn - 0.25f * quarter, s = t * t;
    const float near = 1.0f + s * (-19.7392088f + s * (64.9393940f + s * (-85.4568173f + s * 60.2446414f)));
    const float far = t * (6.28318531f + s * (-41.3417023f + s * (81.6052493f + s * (-76.7058597f +
                           s * 42.0586939f))));
    const bool swapped = quarter & 1;
    cosine = swapped ? far : near;
    sine = swapped ? near : far;
    cosine = (quarter + 1) & 2 ? -cosine : cosine;
    sine = quarter & 2 ? -sine : sine;
}

template <bool FRESH, bool SURFACE, bool FULL>
void scatter(const Pass& p) {
    constexpr int STRIDE = SURFACE ? 8 : 4;
    const float d0 = p.d[0], d1 = p.d[1], d2 = p.d[2];
    const float cutoff = p.cutoff, last = p.last;
    float polynomial[12];
    for (int i = 0; i < 12; ++i) polynomial[i] = p.polynomial[i];
    const float right = p.width + 1.5f, bottom = p.height + 1.5f;
    const int row_length = p.width + 2;
#pragma omp parallel for schedule(dynamic, 512)
    for (std::int64_t n = 0; n < p.count; ++n) {
        const float* const q = p.pixels + 12 * n;
        const float a0 = q[0], a1 = q[1], b0 = q[2], b1 = q[3], column = q[4], row = q[5];
        const float depth = q[6], px = q[7], py = q[8], cosine = q[9], sine = q[10], per_area = q[11];
        const float *const xs = p.x + (FRESH ? 0 : p.version[n] * p.samples);
        const float *const ys = p.y + (FRESH ? 0 : p.version[n] * p.samples);
        const float *const changes = p.change + (FRESH ? 0 : p.version[n] * p.samples);
        const float *const table = p.weights + (FRESH ? 0 : 4 * p.version[n] * p.samples);
        const std::uint32_t s0 = FRESH ? p.shift[2 * n] : 0, s1 = FRESH ? p.shift[2 * n + 1] : 0;
        alignas(64) float sum[4] = {0, 0, 0, 0};
        for (int first = 0; first < p.samples; first += CHUNK) {
            const int size = FULL ? CHUNK : std::min(CHUNK, p.samples - first);
            alignas(64) std::int32_t index[CHUNK];
            alignas(64) float x[CHUNK], y[CHUNK], change[CHUNK], in_column[CHUNK], in_row[CHUNK];
            alignas(64) float w0[CHUNK], w1[CHUNK], w2[CHUNK], z[CHUNK];
            alignas(64) float w[4 * CHUNK];
            if (FRESH) {
#pragma omp simd
                for (int k = 0; k < size; ++k) {
                    const std::uint32_t number = first + k;
                    const float v = (std::int32_t)((s0 + number * 3242174889u) >> 8) * (3.0f * UNIT);
                    const float turn = (std::int32_t)((s1 + number * 2447445414u) >> 8) * UNIT;
                    const int channel = std::min((int)v, 2);
                    const float own = channel == 0 ? d0 : channel == 1 ? d1 : d2;
                    const float xi = std::min((v - channel) * last, 1.0f - UNIT);
                    float total = polynomial[11];
#pragma GCC unroll 11
                    for (int i = 10; i >= 0; --i) total = total * xi + polynomial[i];
                    const float radius = own * (-3.0f * std::log(1.0f - xi) - xi * total);
                    float across, up;
                    rotation(turn, across, up);
                    x[k] = radius * across;
                    y[k] = radius * up;
                    const float g0 = density<!SURFACE>(radius, d0, cutoff);
                    const float g1 = density<!SURFACE>(radius, d1, cutoff);
                    const float g2 = density<!SURFACE>(radius, d2, cutoff);
                    const float scale = 3.0f / (g0 + g1 + g2);
                    // Over the densities with their factors, which is what a table holds.
                    if (SURFACE) change[k] = 4.0f * scale * radius;
                    else w0[k] = scale * g0, w1[k] = scale * g1, w2[k] = scale * g2;
                }
            }
            const float* const sx = FRESH ? x : xs + first;
            const float* const sy = FRESH ? y : ys + first;
#pragma omp simd
            for (int k = 0; k < size; ++k) {
                const float c = std::min(std::max(column + (sx[k] * a0 + sy[k] * a1), 0.0f), right);
                const float r = std::min(std::max(row + (sx[k] * b0 + sy[k] * b1), 0.0f), bottom);
                const int i = (int)c, j = (int)r;
                index[k] = STRIDE * (j * row_length + i);
                if (SURFACE) in_column[k] = c - i - 0.5f, in_row[k] = r - j - 0.5f;
            }
            if (SURFACE) {
                const float* const sc = FRESH ? change : changes + first;
                for (int k = 0; k < size; ++k) {
                    const float* const at = p.source + index[k];
                    z[k] = at[3] + at[4] * in_column[k] + at[5] * in_row[k];
                }
                const float per_depth = 1.0f / depth, factor = per_area / (4.0f * p.within);
#pragma omp simd
                for (int k = 0; k < size; ++k) {
                    const float ox = sx[k] * cosine - sy[k] * sine, oy = sx[k] * sine + sy[k] * cosine;
                    const float stretch = z[k] * per_depth;
                    const float mx = ox * stretch + px * (stretch - 1.0f);
                    const float my = oy * stretch + py * (stretch - 1.0f), mz = depth - z[k];
                    const float distance = std::sqrt(mx * mx + my * my + mz * mz);
                    const float c = sc[k] * factor / std::max(distance, 1e-12f);
                    w0[k] = c * density<true>(distance, d0, cutoff);
                    w1[k] = c * density<true>(distance, d1, cutoff);
                    w2[k] = c * density<true>(distance, d2, cutoff);
                }
            }
            if (FRESH || SURFACE)
#pragma omp simd
                for (int k = 0; k < size; ++k)
                    w[4 * k] = w0[k], w[4 * k + 1] = w1[k], w[4 * k + 2] = w2[k], w[4 * k + 3] = 0.0f;
            const float* const weights = FRESH || SURFACE ? w : table + 4 * first;
            typedef float Four __attribute__((vector_size(16), aligned(4)));
            // Four sums at a time: each waits for its own last addition alone.
            Four part[4] = {};
            int k = 0;
            const auto lit = [&](int at) {
                return *(const Four*)(weights + 4 * at) * *(const Four*)(p.source + index[at]);
            };
            for (; k + 3 < size; k += 4)
                for (int i = 0; i < 4; ++i) part[i] += lit(k + i);
            for (; k < size; ++k) part[0] += lit(k);
            const Four all = (part[0] + part[1]) + (part[2] + part[3]);
            for (int c = 0; c < 3; ++c) sum[c] += all[c];
        }
        for (int c = 0; c < 3; ++c) p.out[3 * n + c] = sum[c] / p.samples;
    }
}

}  // namespace

extern "C" void frames_pass(const Pass* p, int is_fresh, int is_surface) {
    // Loops of a length known to the compiler are faster.
    const bool full = p->samples % CHUNK == 0;
    if (is_fresh && is_surface) full ? scatter<true, true, true>(*p) : scatter<true, true, false>(*p);
    else if (is_fresh) full ? scatter<true, false, true>(*p) : scatter<true, false, false>(*p);
    else if (is_surface) full ? scatter<false, true, true>(*p) : scatter<false, true, false>(*p);
    else full ? scatter<false, false, true>(*p) : scatter<false, false, false>(*p);
}
