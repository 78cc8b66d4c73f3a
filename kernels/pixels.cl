/*
 * pixels.cl: from the focal field to photometry, objective and the source of the adjoint.
 *
 *   h = |U|^2,  U(+-u) = C -+ i S          r = flux h + background - data          J = sum weight r^2
 *   dJ/dU* = G = 2 weight r flux U, stored in place of U as C' = G(+) + G(-), S' = i (G(+) - G(-))
 *
 * Flux and background are given, or minimise J. The sums of w and w d do not depend on the model and come from the host; those
 * of w h, w h^2, w h d are computed here. J is computed from the residuals: the expanded square would cancel in f32.
 *
 * A strip is `pairs_per_strip` row pairs of one image. Its pixels are distributed over `lanes` work-items (1 on a CPU,
 * a work-group on a GPU), each with its own partial sum, so that no atomics are needed. The functions before the kernels
 * process the arrays of one image; focus.cl calls them too.
 */

/* The field of both sides of a row. */
inline void field_of_sides(__global const real *f, const int span, vec re[2], vec im[2]) {
    vec cr = GET(f, 0), ci = GET(f, span), sr = GET(f, 2 * span), si = GET(f, 3 * span);
    re[0] = cr + si, im[0] = ci - sr;
    re[1] = cr - si, im[1] = ci + sr;
}

/* C' and S' of the source of both sides, in place of the field. */
inline void store_source(__global real *f, const int span, const vec re[2], const vec im[2]) {
    AT(f, 0) = re[0] + re[1];
    AT(f, span) = im[0] + im[1];
    AT(f, 2 * span) = im[1] - im[0];
    AT(f, 3 * span) = re[0] - re[1];
}

/* Sums of w h, w h^2, w h d over the rows `row` to `end`. */
inline void strip_sums(__global const real *focal, __global const real *data, __global const real *weight, int row,
                       const int end, const int lane, const int lanes, const int span, __global real *sums) {
    vec wh = SPLAT(REAL(0.0)), whh = SPLAT(REAL(0.0)), whd = SPLAT(REAL(0.0));
    for (; row < end; row++) {
        __global const real *f = focal + (size_t)row * 4 * span;
        __global const real *d = data + (size_t)row * 2 * span, *w = weight + (size_t)row * 2 * span;
        for (int u = lane * VEC; u < span; u += lanes * VEC) {
            vec re[2], im[2];
            field_of_sides(f + u, span, re, im);
#pragma unroll
            for (int side = 0; side < 2; side++) {
                vec h = MAD(re[side], re[side], im[side] * im[side]);
                vec weighted = GET(w, side * span + u) * h;
                wh += weighted;
                whh = MAD(weighted, h, whh);
                whd = MAD(weighted, GET(d, side * span + u), whd);
            }
        }
    }
    sums[0] = sum_lanes(wh);
    sums[1] = sum_lanes(whh);
    sums[2] = sum_lanes(whd);
}

/* Adds the partial sums `i`, `i + step`, ... of `count` to `total`. */
inline void add_partials(__global const real *sums, int i, const int step, const int count, wide total[3]) {
    for (; i < count; i += step) {
        total[0] += sums[3 * i];
        total[1] += sums[3 * i + 1];
        total[2] += sums[3 * i + 2];
    }
}

/* Flux and background of an image. total: sums of w h, w h^2, w h d. kind: 0 both known, 1 flux fitted, 2 both fitted; known: flux,
   background, sum w, sum w d. Where the image does not determine a value (no signal, no good pixel), it is zero. */
inline void solve(const wide total[3], const int kind, __global const real *known, __global real *photometry) {
    wide flux = known[0], background = known[1];
    const wide wh = total[0], whh = total[1], whd = total[2], w = known[2], wd = known[3];
    if (kind == 1) {
        flux = whh > 0 ? (whd - background * wh) / whh : 0;
    } else if (kind == 2) {
        const wide determinant = w * whh - wh * wh;
        flux = determinant > 0 ? (w * whd - wh * wd) / determinant : 0;
        background = w > 0 ? (wd - flux * wh) / w : 0;
    }
    photometry[0] = flux;
    photometry[1] = background;
}

/* The same from all partial sums. */
inline void add_and_solve(__global const real *sums, const int count, const int kind, __global const real *known,
                          __global real *photometry) {
    wide total[3] = {0, 0, 0};
    if (kind != 0) add_partials(sums, 0, 1, count, total);
    solve(total, kind, known, photometry);
}

/* Objective over the rows `row` to `end`; the source of the adjoint replaces the focal field. */
inline real strip_residuals(__global real *focal, __global const real *data, __global const real *weight, int row,
                            const int end, const int lane, const int lanes, const int span,
                            __global const real *photometry) {
    const vec flux = SPLAT(photometry[0]), background = SPLAT(photometry[1]), twice_flux = flux + flux;
    vec sum = SPLAT(REAL(0.0));
    for (; row < end; row++) {
        __global real *f = focal + (size_t)row * 4 * span;
        __global const real *d = data + (size_t)row * 2 * span, *w = weight + (size_t)row * 2 * span;
        for (int u = lane * VEC; u < span; u += lanes * VEC) {
            vec re[2], im[2];
            field_of_sides(f + u, span, re, im);
#pragma unroll
            for (int side = 0; side < 2; side++) {
                vec h = MAD(re[side], re[side], im[side] * im[side]);
                vec r = MAD(flux, h, background - GET(d, side * span + u));
                vec wr = GET(w, side * span + u) * r;
                sum = MAD(wr, r, sum);
                re[side] *= twice_flux * wr;
                im[side] *= twice_flux * wr;
            }
            store_source(f + u, span, re, im);
        }
    }
    return sum_lanes(sum);
}

/* -> sums [image][strip * lanes + lane][3]: global (lanes, strips, images). */
__kernel void photometry_sums(__global const real *focal, __global const real *data, __global const real *weight,
                              __global const int *slot, __global real *sums, const int first, const int pairs,
                              const int pairs_per_strip, const int span) {
    const size_t lanes = get_global_size(0), strip = get_global_id(1), image = get_global_id(2);
    const size_t pixel = (size_t)slot[first + image] * pairs * 4 * span;
    strip_sums(focal + image * pairs * 8 * span, data + pixel, weight + pixel, 2 * strip * pairs_per_strip,
               2 * min(pairs, (int)(strip + 1) * pairs_per_strip), get_global_id(0), lanes, span,
               sums + ((image * get_global_size(1) + strip) * lanes + get_global_id(0)) * 3);
}

/* sums -> photometry [image][flux, background]: global (SOLVERS, images, 1), of which a group has all of an image on a GPU, and
   (1, images, 1) on a CPU. */
#define SOLVERS 32
__kernel void photometry_solve(__global const real *sums, __global const int *slot, __global const int *kind,
                               __global const real *known, __global real *photometry, const int first,
                               const int partials) {
    __local wide shares[SOLVERS][3];
    const int image = get_global_id(1), solver = get_local_id(0), solvers = get_local_size(0);
    const int s = slot[first + image];
    wide total[3] = {0, 0, 0};
    if (kind[s] != 0) add_partials(sums + (size_t)image * partials * 3, solver, solvers, partials, total);
    for (int i = 0; i < 3; i++)
        shares[solver][i] = total[i];
    barrier(CLK_LOCAL_MEM_FENCE);
    if (solver != 0) return;
    for (int other = 1; other < solvers; other++)
        for (int i = 0; i < 3; i++)
            total[i] += shares[other][i];
    solve(total, kind[s], known + 4 * s, photometry + 2 * image);
}

/* -> objective [image][strip * lanes + lane], and focal in place: global (lanes, strips, images). */
__kernel void residuals(__global real *focal, __global const real *data, __global const real *weight,
                        __global const int *slot, __global const real *photometry, __global real *objective,
                        const int first, const int pairs, const int pairs_per_strip, const int span) {
    const size_t lanes = get_global_size(0), strip = get_global_id(1), image = get_global_id(2);
    const size_t pixel = (size_t)slot[first + image] * pairs * 4 * span;
    objective[(image * get_global_size(1) + strip) * lanes + get_global_id(0)] =
        strip_residuals(focal + image * pairs * 8 * span, data + pixel, weight + pixel, 2 * strip * pairs_per_strip,
                        2 * min(pairs, (int)(strip + 1) * pairs_per_strip), get_global_id(0), lanes, span,
                        photometry + 2 * image);
}
