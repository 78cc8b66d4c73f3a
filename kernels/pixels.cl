/*
 * pixels.cl: from the focal field to photometry, objective and the adjoint's source.
 *
 *   h = |U|^2,  U(+-u) = C -+ i S          r = flux h + background - data          J = sum weight r^2
 *   dJ/dU* = G = 2 weight r flux U, left in place of U as C' = G(+) + G(-), S' = i (G(+) - G(-))
 *
 * Flux and background are given, or minimise J: the sums of w, w d are the host's (they never change), those of
 * w h, w h^2, w h d are taken here. J is taken from the residuals: the expanded square would cancel in f32.
 *
 * A strip is `pairs_per_strip` row pairs of one image. Its numbers are shared by `lanes` work-items (1 on a processor,
 * a work-group on a GPU), each with its own partial sum: nothing is added twice in different orders, no atomics.
 */

/* photometry_sums -> partial [image][strip * lanes + lane][3]: global (lanes, strips, images). */
__kernel void photometry_sums(__global const real *focal, __global const real *data, __global const real *weight,
                              __global const int *slot, __global real *partial, const int first, const int pairs,
                              const int pairs_per_strip, const int span) {
    const int lanes = get_global_size(0), lane = get_global_id(0), strip = get_global_id(1), image = get_global_id(2);
    const int end = min(pairs, (strip + 1) * pairs_per_strip);
    vec wh = SPLAT(REAL(0.0)), whh = SPLAT(REAL(0.0)), whd = SPLAT(REAL(0.0));
    for (int row = 2 * strip * pairs_per_strip; row < 2 * end; row++) {
        __global const real *f = focal + (size_t)(image * pairs * 2 + row) * 4 * span;
        const size_t pixel = ((size_t)slot[first + image] * pairs * 2 + row) * 2 * span;
        for (int u = lane * VEC; u < span; u += lanes * VEC) {
            vec cr = GET(f, u), ci = GET(f, span + u), sr = GET(f, 2 * span + u), si = GET(f, 3 * span + u);
#pragma unroll
            for (int side = 0; side < 2; side++) {
                vec re = side ? cr - si : cr + si, im = side ? ci + sr : ci - sr;
                vec h = MAD(re, re, im * im);
                vec d = GET(data, pixel + side * span + u), w = GET(weight, pixel + side * span + u) * h;
                wh += w;
                whh = MAD(w, h, whh);
                whd = MAD(w, d, whd);
            }
        }
    }
    __global real *out = partial + ((size_t)(image * get_global_size(1) + strip) * lanes + lane) * 3;
    out[0] = sum_lanes(wh);
    out[1] = sum_lanes(whh);
    out[2] = sum_lanes(whd);
}

/* photometry_solve: flux and background of each image, by its slot's kind: 0 as given, 1 flux fitted with the background
   as given, 2 both fitted. known is [slot][given flux, given background, sum w, sum w d]. Where an image does not
   determine them (no signal, no good pixel) they are zero, and the objective says so. global (images, 1, 1). */
__kernel void photometry_solve(__global const real *partial, __global const int *slot, __global const int *kind,
                               __global const real *known, __global real *photometry, const int first, const int images,
                               const int partials) {
    const int image = get_global_id(0);
    if (image >= images) return;
    const int s = slot[first + image];
    __global const real *k = known + 4 * s;
    wide flux = k[0], background = k[1];
    if (kind[s] != 0) {
        wide wh = 0, whh = 0, whd = 0;
        for (int i = 0; i < partials; i++) {
            __global const real *p = partial + ((size_t)image * partials + i) * 3;
            wh += p[0];
            whh += p[1];
            whd += p[2];
        }
        const wide w = k[2], wd = k[3];
        if (kind[s] == 1) {
            flux = whh > 0 ? (whd - background * wh) / whh : 0;
        } else {
            const wide determinant = w * whh - wh * wh;
            flux = determinant > 0 ? (w * whd - wh * wd) / determinant : 0;
            background = w > 0 ? (wd - flux * wh) / w : 0;
        }
    }
    photometry[2 * image] = flux;
    photometry[2 * image + 1] = background;
}

/* residuals -> objective partials [image][strip * lanes + lane], focal in place: global (lanes, strips, images). */
__kernel void residuals(__global real *focal, __global const real *data, __global const real *weight,
                        __global const int *slot, __global const real *photometry, __global real *objective,
                        const int first, const int pairs, const int pairs_per_strip, const int span) {
    const int lanes = get_global_size(0), lane = get_global_id(0), strip = get_global_id(1), image = get_global_id(2);
    const int end = min(pairs, (strip + 1) * pairs_per_strip);
    const vec flux = SPLAT(photometry[2 * image]), background = SPLAT(photometry[2 * image + 1]);
    const vec twice_flux = flux + flux;
    vec sum = SPLAT(REAL(0.0));
    for (int row = 2 * strip * pairs_per_strip; row < 2 * end; row++) {
        __global real *f = focal + (size_t)(image * pairs * 2 + row) * 4 * span;
        const size_t pixel = ((size_t)slot[first + image] * pairs * 2 + row) * 2 * span;
        for (int u = lane * VEC; u < span; u += lanes * VEC) {
            vec cr = GET(f, u), ci = GET(f, span + u), sr = GET(f, 2 * span + u), si = GET(f, 3 * span + u);
            vec re[2], im[2];
#pragma unroll
            for (int side = 0; side < 2; side++) {
                re[side] = side ? cr - si : cr + si;
                im[side] = side ? ci + sr : ci - sr;
                vec h = MAD(re[side], re[side], im[side] * im[side]);
                vec r = MAD(flux, h, background - GET(data, pixel + side * span + u));
                vec wr = GET(weight, pixel + side * span + u) * r;
                sum = MAD(wr, r, sum);
                re[side] *= twice_flux * wr;
                im[side] *= twice_flux * wr;
            }
            AT(f, u) = re[0] + re[1];
            AT(f, span + u) = im[0] + im[1];
            AT(f, 2 * span + u) = im[1] - im[0];
            AT(f, 3 * span + u) = re[0] - re[1];
        }
    }
    objective[(size_t)(image * get_global_size(1) + strip) * lanes + lane] = sum_lanes(sum);
}
