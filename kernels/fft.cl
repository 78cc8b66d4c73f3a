/*
 * fft.cl: focus.cl with an FFT in place of the matrix products, for whole images (as many pixels as the zero-padded pupil has
 * samples). It takes a seventh of the operations at 240 pixels.
 *
 * Preprocessor definitions (without them this file is empty): FFT_A, FFT_B, two of 8, 12, 15, 16, 20 with N = FFT_A FFT_B;
 * FFT_NONZERO, the number of blocks of FFT_B inputs on either side of the axis that are not all zero (of FFT_A blocks in all).
 *
 * N points in two passes through memory, in place: j = B a + b, f = r + A k,
 *
 *   T[r][b] = exp(-2 pi i b r / N) sum_a z[B a + b] exp(-2 pi i a r / A)       (pruned: only the nonzero blocks are read)
 *   Z[r][k] = sum_b T[r][b] exp(-2 pi i b k / B)
 *
 * Frequencies stay in the order [r][k]: the host stores data and weights so. The adjoint runs backwards, on numbers with
 * re and im exchanged, which conjugates every factor. A vector is VEC neighbours in x down the columns, and VEC rows along
 * the rows, exchanged by transposing VEC x VEC blocks on the way.
 *
 * Samples are counted +0, +1, ... and -1 = N - 1, ... from the axis. They lie half a sample farther, which multiplies each
 * pixel with a phase factor: the intensity does not depend on it, and the adjoint divides it out.
 *
 *   field  [y sign][y][x sign][re, im][x]    y padded to FFT_NONZERO FFT_B, zero there
 *   wave   [frequency of y][x sign][re, im][x]
 *   focal  [VEC frequencies of y][frequency of x][re, im][VEC]
 *   pixels [slot][VEC frequencies of y][frequency of x][VEC]
 */
#if defined(FFT_A) && VEC > 1
#define FFT_N (FFT_A * FFT_B)
#define NONZERO_ROWS (FFT_NONZERO * FFT_B)
#define DFT(radix) JOIN(dft_, radix)

/* Transforms of a few numbers in registers: index k of the arrays is input k, then output k. */
inline void dft_3(vec *re, vec *im) {
    const vec minus_half = SPLAT(REAL(-0.5)), root = SPLAT(REAL(0.86602540378443864676));
    vec sr = re[1] + re[2], si = im[1] + im[2], dr = root * (re[1] - re[2]), di = root * (im[1] - im[2]);
    vec mr = MAD(minus_half, sr, re[0]), mi = MAD(minus_half, si, im[0]);
    re[0] += sr, im[0] += si;
    re[1] = mr + di, im[1] = mi - dr;
    re[2] = mr - di, im[2] = mi + dr;
}

inline void dft_4(vec *re, vec *im) {
    vec ar = re[0] + re[2], ai = im[0] + im[2], br = re[0] - re[2], bi = im[0] - im[2];
    vec cr = re[1] + re[3], ci = im[1] + im[3], dr = re[1] - re[3], di = im[1] - im[3];
    re[0] = ar + cr, im[0] = ai + ci;
    re[1] = br + di, im[1] = bi - dr;
    re[2] = ar - cr, im[2] = ai - ci;
    re[3] = br - di, im[3] = bi + dr;
}

inline void dft_5(vec *re, vec *im) {
    const vec c1 = SPLAT(REAL(0.30901699437494742410)), c2 = SPLAT(REAL(-0.80901699437494742410));
    const vec s1 = SPLAT(REAL(0.95105651629515357212)), s2 = SPLAT(REAL(0.58778525229247312917));
    vec ar = re[1] + re[4], ai = im[1] + im[4], br = re[2] + re[3], bi = im[2] + im[3];
    vec dr = re[1] - re[4], di = im[1] - im[4], er = re[2] - re[3], ei = im[2] - im[3];
    vec pr = MAD(c1, ar, MAD(c2, br, re[0])), pi = MAD(c1, ai, MAD(c2, bi, im[0]));
    vec qr = MAD(c2, ar, MAD(c1, br, re[0])), qi = MAD(c2, ai, MAD(c1, bi, im[0]));
    vec tr = MAD(s1, dr, s2 * er), ti = MAD(s1, di, s2 * ei), ur = MAD(s2, dr, -s1 * er), ui = MAD(s2, di, -s1 * ei);
    re[0] += ar + br, im[0] += ai + bi;
    re[1] = pr + ti, im[1] = pi - tr;
    re[4] = pr - ti, im[4] = pi + tr;
    re[2] = qr + ui, im[2] = qi - ur;
    re[3] = qr - ui, im[3] = qi + ur;
}

/* Coprime factors need no twiddle factors: input (Q a + P b) mod PQ, output by the remainders of k (Good-Thomas). */
#define DFT_COPRIME(NAME, P, Q)                                                                                        \
    inline void NAME(vec *re, vec *im) {                                                                               \
        vec xr[Q][P], xi[Q][P];                                                                                        \
        _Pragma("unroll") for (int b = 0; b < Q; b++) {                                                                \
            _Pragma("unroll") for (int a = 0; a < P; a++) {                                                            \
                xr[b][a] = re[(Q * a + P * b) % (P * Q)];                                                              \
                xi[b][a] = im[(Q * a + P * b) % (P * Q)];                                                              \
            }                                                                                                          \
            DFT(P)(xr[b], xi[b]);                                                                                      \
        }                                                                                                              \
        _Pragma("unroll") for (int r = 0; r < P; r++) {                                                                \
            vec yr[Q], yi[Q];                                                                                          \
            _Pragma("unroll") for (int b = 0; b < Q; b++) yr[b] = xr[b][r], yi[b] = xi[b][r];                          \
            DFT(Q)(yr, yi);                                                                                            \
            _Pragma("unroll") for (int k = 0; k < P * Q; k++)                                                          \
                if (k % P == r) re[k] = yr[k % Q], im[k] = yi[k % Q];                                                  \
        }                                                                                                              \
    }

DFT_COPRIME(dft_12, 3, 4)
DFT_COPRIME(dft_15, 3, 5)
DFT_COPRIME(dft_20, 4, 5)

inline void rotate(vec *re, vec *im, const real c, const real s) {
    vec r = MAD(SPLAT(c), *re, SPLAT(s) * *im);
    *im = MAD(SPLAT(c), *im, SPLAT(-s) * *re);
    *re = r;
}

/* 4 x Q with the factors exp(-2 pi i b r / (4 Q)) between, Q = 2 or 4. */
__constant const real TURNS_16[10][2] = {{REAL(1.0), REAL(0.0)},
                                         {REAL(0.92387953251128675613), REAL(0.38268343236508977173)},
                                         {REAL(0.70710678118654752440), REAL(0.70710678118654752440)},
                                         {REAL(0.38268343236508977173), REAL(0.92387953251128675613)},
                                         {REAL(0.0), REAL(1.0)},
                                         {REAL(-0.38268343236508977173), REAL(0.92387953251128675613)},
                                         {REAL(-0.70710678118654752440), REAL(0.70710678118654752440)},
                                         {REAL(-0.92387953251128675613), REAL(0.38268343236508977173)},
                                         {REAL(-1.0), REAL(0.0)},
                                         {REAL(-0.92387953251128675613), REAL(-0.38268343236508977173)}};

inline void dft_2(vec *re, vec *im) {
    vec r = re[0] - re[1], i = im[0] - im[1];
    re[0] += re[1], im[0] += im[1];
    re[1] = r, im[1] = i;
}

#define DFT_TWIDDLED(NAME, Q)                                                                                          \
    inline void NAME(vec *re, vec *im) {                                                                               \
        vec xr[Q][4], xi[Q][4];                                                                                        \
        _Pragma("unroll") for (int b = 0; b < Q; b++) {                                                                \
            _Pragma("unroll") for (int a = 0; a < 4; a++) xr[b][a] = re[Q * a + b], xi[b][a] = im[Q * a + b];          \
            dft_4(xr[b], xi[b]);                                                                                       \
            _Pragma("unroll") for (int r = 1; r < 4; r++)                                                              \
                if (b > 0)                                                                                             \
                    rotate(&xr[b][r], &xi[b][r], TURNS_16[b * r * 4 / Q][0], TURNS_16[b * r * 4 / Q][1]);             \
        }                                                                                                              \
        _Pragma("unroll") for (int r = 0; r < 4; r++) {                                                                \
            vec yr[Q], yi[Q];                                                                                          \
            _Pragma("unroll") for (int b = 0; b < Q; b++) yr[b] = xr[b][r], yi[b] = xi[b][r];                          \
            DFT(Q)(yr, yi);                                                                                            \
            _Pragma("unroll") for (int k = 0; k < Q; k++) re[r + 4 * k] = yr[k], im[r + 4 * k] = yi[k];                \
        }                                                                                                              \
    }

DFT_TWIDDLED(dft_8, 2)
DFT_TWIDDLED(dft_16, 4)

/* Whether input block a may be nonzero. */
#define IS_NONZERO(a) ((a) < FFT_NONZERO || (a) >= FFT_A - FFT_NONZERO)

/* First pass: `near` and `far` are sample 0 on either side of the axis, samples are `step` apart, and im is `apart` from
   re. Into line [r][b][re, im][VEC]. twiddle: [b][r][cos, sin]. */
inline void fft_first(__global const real *near, __global const real *far, const int step, const int apart,
                      __global const real *twiddle, __global real *line) {
    for (int b = 0; b < FFT_B; b++, twiddle += 2 * FFT_A) {
        vec re[FFT_A], im[FFT_A];
#pragma unroll
        for (int a = 0; a < FFT_A; a++) {
            re[a] = im[a] = SPLAT(REAL(0.0));
            if (IS_NONZERO(a)) {
                const int j = FFT_B * a + b;
                __global const real *z = a < FFT_NONZERO ? near + j * step : far + (FFT_N - 1 - j) * step;
                re[a] = GET(z, 0);
                im[a] = GET(z, apart);
            }
        }
        DFT(FFT_A)(re, im);
#pragma unroll
        for (int r = 0; r < FFT_A; r++) {
            const vec c = SPLAT(twiddle[2 * r]), s = SPLAT(twiddle[2 * r + 1]);
            AT(line, ((r * FFT_B + b) * 2) * VEC) = MAD(c, re[r], s * im[r]);
            AT(line, ((r * FFT_B + b) * 2 + 1) * VEC) = MAD(c, im[r], -s * re[r]);
        }
    }
}

/* Adjoint of fft_first. Samples from `limit` on are outside the pupil and are not written. */
inline void fft_first_adjoint(__global const real *line, __global const real *twiddle, __global real *near,
                              __global real *far, const int step, const int apart, const int limit) {
    for (int b = 0; b < FFT_B; b++, twiddle += 2 * FFT_A) {
        vec re[FFT_A], im[FFT_A];
#pragma unroll
        for (int r = 0; r < FFT_A; r++) {
            const vec c = SPLAT(twiddle[2 * r]), s = SPLAT(twiddle[2 * r + 1]);
            const vec x = GET(line, ((r * FFT_B + b) * 2) * VEC), y = GET(line, ((r * FFT_B + b) * 2 + 1) * VEC);
            re[r] = MAD(c, x, -s * y);
            im[r] = MAD(c, y, s * x);
        }
        DFT(FFT_A)(im, re);
#pragma unroll
        for (int a = 0; a < FFT_A; a++) {
            if (IS_NONZERO(a)) {
                const int j = FFT_B * a + b, i = a < FFT_NONZERO ? j : FFT_N - 1 - j;
                if (i < limit) {
                    __global real *z = (a < FFT_NONZERO ? near : far) + i * step;
                    AT(z, 0) = re[a];
                    AT(z, apart) = im[a];
                }
            }
        }
    }
}

/* Transform along y of one vector of columns, to all frequencies. */
inline void fft_column(__global const real *field, __global const real *twiddle, __global real *line,
                       __global real *wave, const int width) {
    fft_first(field, field + NONZERO_ROWS * 4 * width, 4 * width, width, twiddle, line);
    for (int r = 0; r < FFT_A; r++, line += FFT_B * 2 * VEC, wave += FFT_B * 4 * width) {
        vec re[FFT_B], im[FFT_B];
#pragma unroll
        for (int b = 0; b < FFT_B; b++) re[b] = GET(line, 2 * b * VEC), im[b] = GET(line, (2 * b + 1) * VEC);
        DFT(FFT_B)(re, im);
#pragma unroll
        for (int k = 0; k < FFT_B; k++) AT(wave, k * 4 * width) = re[k], AT(wave, (4 * k + 1) * width) = im[k];
    }
}

inline void fft_column_adjoint(__global const real *wave, __global const real *twiddle, __global real *line,
                               __global real *field, const int width, const int limit) {
    __global real *out = line;
    for (int r = 0; r < FFT_A; r++, out += FFT_B * 2 * VEC, wave += FFT_B * 4 * width) {
        vec re[FFT_B], im[FFT_B];
#pragma unroll
        for (int k = 0; k < FFT_B; k++) re[k] = GET(wave, k * 4 * width), im[k] = GET(wave, (4 * k + 1) * width);
        DFT(FFT_B)(im, re);
#pragma unroll
        for (int b = 0; b < FFT_B; b++) AT(out, 2 * b * VEC) = re[b], AT(out, (2 * b + 1) * VEC) = im[b];
    }
    fft_first_adjoint(line, twiddle, field, field + NONZERO_ROWS * 4 * width, 4 * width, width, limit);
}

/* Transposes VEC vectors `in_step` apart into VEC vectors `out_step` apart, by perfect shuffles. */
inline void transpose(__global const real *in, const int in_step, __global real *out, const int out_step) {
    vec a[VEC];
#pragma unroll
    for (int i = 0; i < VEC; i++) a[i] = GET(in, i * in_step);
#pragma unroll
    for (int round = 1; round < VEC; round *= 2) {
        vec b[VEC];
#pragma unroll
        for (int i = 0; i < VEC / 2; i++) {
            b[2 * i].even = a[i].lo, b[2 * i].odd = a[i + VEC / 2].lo;
            b[2 * i + 1].even = a[i].hi, b[2 * i + 1].odd = a[i + VEC / 2].hi;
        }
#pragma unroll
        for (int i = 0; i < VEC; i++) a[i] = b[i];
    }
#pragma unroll
    for (int i = 0; i < VEC; i++) AT(out, i * out_step) = a[i];
}

/* Transform along x of VEC rows of the wave, with the sums of w h, w h^2, w h d. `side` holds the samples of these rows:
   [x sign][x][re, im][VEC], x padded to the larger of `width` and NONZERO_ROWS. */
inline void fft_rows(__global const real *wave, __global const real *twiddle, __global real *side, const int side_step,
                     __global real *focal, __global const real *data, __global const real *weight, const int width,
                     __global real *sums) {
    vec wh = SPLAT(REAL(0.0)), whh = SPLAT(REAL(0.0)), whd = SPLAT(REAL(0.0));
    for (int sign = 0; sign < 2; sign++)
        for (int part = 0; part < 2; part++)
            for (int x = 0; x < width; x += VEC)
                transpose(wave + (2 * sign + part) * width + x, 4 * width,
                          side + sign * side_step + (2 * x + part) * VEC, 2 * VEC);
    fft_first(side, side + side_step, 2 * VEC, VEC, twiddle, focal);
    for (int r = 0; r < FFT_A; r++, focal += FFT_B * 2 * VEC, data += FFT_B * VEC, weight += FFT_B * VEC) {
        vec re[FFT_B], im[FFT_B];
#pragma unroll
        for (int b = 0; b < FFT_B; b++) re[b] = GET(focal, 2 * b * VEC), im[b] = GET(focal, (2 * b + 1) * VEC);
        DFT(FFT_B)(re, im);
#pragma unroll
        for (int k = 0; k < FFT_B; k++) {
            AT(focal, 2 * k * VEC) = re[k], AT(focal, (2 * k + 1) * VEC) = im[k];
            const vec h = MAD(re[k], re[k], im[k] * im[k]), weighted = GET(weight, k * VEC) * h;
            wh += weighted;
            whh = MAD(weighted, h, whh);
            whd = MAD(weighted, GET(data, k * VEC), whd);
        }
    }
    sums[0] = sum_lanes(wh);
    sums[1] = sum_lanes(whh);
    sums[2] = sum_lanes(whd);
}

/* Adjoint of fft_rows, starting from the residuals; returns the objective. */
inline real fft_rows_adjoint(__global real *focal, __global const real *data, __global const real *weight,
                             __global const real *photometry, __global const real *twiddle, __global real *side,
                             const int side_step, __global real *wave, const int width) {
    vec sum = SPLAT(REAL(0.0));
    const vec flux = SPLAT(photometry[0]), background = SPLAT(photometry[1]), twice_flux = flux + flux;
    __global real *f = focal;
    for (int r = 0; r < FFT_A; r++, f += FFT_B * 2 * VEC, data += FFT_B * VEC, weight += FFT_B * VEC) {
        vec re[FFT_B], im[FFT_B];
#pragma unroll
        for (int k = 0; k < FFT_B; k++) {
            re[k] = GET(f, 2 * k * VEC), im[k] = GET(f, (2 * k + 1) * VEC);
            const vec h = MAD(re[k], re[k], im[k] * im[k]);
            const vec residual = MAD(flux, h, background - GET(data, k * VEC));
            const vec weighted = GET(weight, k * VEC) * residual;
            sum = MAD(weighted, residual, sum);
            re[k] *= twice_flux * weighted;
            im[k] *= twice_flux * weighted;
        }
        DFT(FFT_B)(im, re);
#pragma unroll
        for (int b = 0; b < FFT_B; b++) AT(f, 2 * b * VEC) = re[b], AT(f, (2 * b + 1) * VEC) = im[b];
    }
    fft_first_adjoint(focal, twiddle, side, side + side_step, 2 * VEC, VEC, width);
    for (int sign = 0; sign < 2; sign++)
        for (int part = 0; part < 2; part++)
            for (int x = 0; x < width; x += VEC)
                transpose(side + sign * side_step + (2 * x + part) * VEC, 2 * VEC,
                          wave + (2 * sign + part) * width + x, 4 * width);
    return sum_lanes(sum);
}

/* As `focus`, with the same launch sizes. Per worker, `line` holds N complex vectors and `side` 2 `side_rows` of them. */
__kernel void focus_fft(__global real *psi, __global const int *place, __global const int *entry_start,
                        __global const int *entry_segment, __global const real *entry_weight,
                        __global const real *entry_x, __global const real *entry_y, __global const int *segment_start,
                        __global const int *segment_entry, __global const int *entry_place, __global const real *pose,
                        __global real *phasor, __global real *sample_field, __global real *field,
                        __global const real *twiddle, __global const int *extent, __global real *line,
                        __global real *side, __global real *wave,
                        __global real *focal, __global const real *data, __global const real *weight,
                        __global const int *slot, __global const int *kind, __global const real *known,
                        __global real *sums, __global real *objective, __global real *photometry,
                        __global real *segment_sum, volatile __global int *next, const int tile, const int first,
                        const int images, const int blocks, const int segments, const int poses, const int width,
                        const int side_rows) {
    const size_t worker = get_global_id(0);
    const int side_step = side_rows * 2 * VEC;
    __global real *e = field + worker * 2 * NONZERO_ROWS * 4 * width, *w = wave + worker * FFT_N * 4 * width;
    __global real *f = focal + worker * FFT_N * FFT_N * 2, *z = line + worker * FFT_N * 2 * VEC;
    __global real *h = side + worker * 2 * side_step;
    __global real *p = phasor + worker * blocks * 8 * VEC, *l = sample_field + worker * blocks * 8 * VEC;
    for (int image = atomic_inc(next + tile); image < images; image = atomic_inc(next + tile)) {
        const int s = slot[first + image], strips = FFT_N / VEC;
        __global const real *image_pose = pose + (size_t)(first + image) * segments * 4;
        __global real *t = psi + (size_t)image * blocks * 4 * VEC;
        __global const real *d = data + (size_t)s * FFT_N * FFT_N, *v = weight + (size_t)s * FFT_N * FFT_N;
        __global real *image_photometry = photometry + 2 * image;
        __global real *sum = sums + (size_t)image * strips * 3;

        for (int block = 0; block < blocks; block++)
            field_block(t, 0, REAL(1.0), place, entry_start, entry_segment, entry_weight, entry_x, entry_y, image_pose, p, l,
                        e, block, blocks, width, poses, NONZERO_ROWS);
        for (int x = 0; x < width; x += VEC)
            for (int sign = 0; sign < 2; sign++)
                fft_column(e + 2 * sign * width + x, twiddle, z, w + 2 * sign * width + x, width);
        for (int v0 = 0; v0 < FFT_N; v0 += VEC)
            fft_rows(w + v0 * 4 * width, twiddle, h, side_step, f + v0 * FFT_N * 2, d + v0 * FFT_N, v + v0 * FFT_N, width,
                     sum + v0 / VEC * 3);
        add_and_solve(sum, strips, kind[s], known + 4 * s, image_photometry);
        for (int v0 = 0; v0 < FFT_N; v0 += VEC)
            objective[image * strips + v0 / VEC] =
                fft_rows_adjoint(f + v0 * FFT_N * 2, d + v0 * FFT_N, v + v0 * FFT_N, image_photometry, twiddle, h,
                                 side_step, w + v0 * 4 * width, width);
        for (int x = 0; x < width; x += VEC)
            for (int sign = 0; sign < 2; sign++)
                fft_column_adjoint(w + 2 * sign * width + x, twiddle, z, e + 2 * sign * width + x, width,
                                   extent[x / VEC]);
        for (int block = 0; block < blocks; block++)
            gradient_block(e, l, p, place, t, REAL(1.0), 1, block, blocks, width, NONZERO_ROWS);
        for (int segment = 0; segment < segments; segment++)
            segment_product(p, segment_entry, entry_place, entry_weight, entry_x, entry_y, image_pose + 4 * segment,
                            segment_sum + ((size_t)image * segments + segment) * poses, REAL(1.0), 1,
                            segment_start[segment], segment_start[segment + 1], COMPLEX_APART(blocks), poses);
    }
}
#endif
