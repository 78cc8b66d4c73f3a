/*
 * intensity.cl: the stages of pixels.cl for images of several wavelengths, and of pixels with an area. The intensity is stored.
 *
 *   h = R sum_k |U_k|^2                R: the response of the pixels, a symmetric convolution, which is its own adjoint
 *   dJ/dU_k* = G_k = s U_k,            s = R (2 weight r flux)
 *
 * add_intensity adds |U_k|^2 of one wavelength; convolve_rows and then convolve_columns are R; intensity_sums and
 * intensity_residuals are photometry_sums and residuals, the second of which leaves 2 weight r flux in place of h; scale_field
 * multiplies the field of a wavelength by s and stores C' and S'.
 *
 *   intensity [image][pair][+v, -v][+u, -u][u]      as the pixels
 *
 * All kernels: global (lanes, strips, images).
 */

/* First and last row of this work-item's strip. */
#define FIRST_ROW (2 * (int)get_global_id(1) * pairs_per_strip)
#define LAST_ROW (2 * min(pairs, ((int)get_global_id(1) + 1) * pairs_per_strip))
#define LANE ((int)get_global_id(0) * VEC)
#define LANES ((int)get_global_size(0) * VEC)

/* intensity (+)= |U|^2. */
__kernel void add_intensity(__global const real *focal, __global real *intensity, const int pairs,
                            const int pairs_per_strip, const int span, const int is_first) {
    __global const real *f = focal + get_global_id(2) * pairs * 8 * span;
    __global real *h = intensity + get_global_id(2) * pairs * 4 * span;
    for (int row = FIRST_ROW; row < LAST_ROW; row++) {
        for (int u = LANE; u < span; u += LANES) {
            vec re[2], im[2];
            field_of_sides(f + (size_t)row * 4 * span + u, span, re, im);
#pragma unroll
            for (int side = 0; side < 2; side++) {
                __global real *pixel = h + ((size_t)row * 2 + side) * span + u;
                vec value = MAD(re[side], re[side], im[side] * im[side]);
                AT(pixel, 0) = is_first ? value : value + GET(pixel, 0);
            }
        }
    }
}

/* Pixel `steps` away from pixel 0 of `side`, in the direction away from the axis: t for pixel t of side 0, -1 - t for pixel t of
   side 1. Beyond the border the image is continued by its mirror image. */
inline int neighbour(const int side, const int steps, const int pairs) {
    int x = side ? pairs - 1 - steps : pairs + steps;
    while (x < 0 || x >= 2 * pairs) x = x < 0 ? -1 - x : 4 * pairs - 1 - x;
    return x - pairs;
}

/* One pixel of the convolution along a row. */
inline real convolved_pixel(__global const real *row, __global const real *terms, const int reach, const int side,
                            const int u, const int pairs, const int span) {
    real sum = terms[0] * row[side * span + u];
    for (int k = 1; k <= reach; k++) {
        const int below = neighbour(side, u - k, pairs), above = neighbour(side, u + k, pairs);
        sum = MAD(terms[k], row[below < 0 ? span - 1 - below : below] + row[above < 0 ? span - 1 - above : above], sum);
    }
    return sum;
}

#if VEC > 1
/* Longest row, with `reach` pixels on either side, that convolved_row takes. */
#define LONGEST 2048

/* A row, along u: unfolded into the order of pixels, so that neighbours are next to each other, and folded again. */
inline void convolved_row(__global const real *row, __global real *out, __global const real *terms, const int reach,
                          const int pairs, const int span) {
    real line[LONGEST], sums[LONGEST];
    for (int u = 0; u < pairs; u++) {
        line[reach + pairs + u] = row[u];
        line[reach + pairs - 1 - u] = row[span + u];
    }
    for (int k = 0; k < reach; k++) {
        const int below = neighbour(0, -pairs - 1 - k, pairs), above = neighbour(0, pairs + k, pairs);
        line[reach - 1 - k] = row[below < 0 ? span - 1 - below : below];
        line[reach + 2 * pairs + k] = row[above < 0 ? span - 1 - above : above];
    }
    /* The last vector may reach beyond the row, into what is not used. */
    for (int x = 0; x < 2 * pairs; x += VEC) {
        const real *here = line + reach + x;
        vec sum = SPLAT(terms[0]) * JOIN(vload, VEC)(0, here);
        for (int k = 1; k <= reach; k++)
            sum = MAD(SPLAT(terms[k]), JOIN(vload, VEC)(0, here - k) + JOIN(vload, VEC)(0, here + k), sum);
        JOIN(vstore, VEC)(sum, 0, sums + x);
    }
    for (int u = 0; u < span; u++) {
        out[u] = u < pairs ? sums[pairs + u] : REAL(0.0);
        out[span + u] = u < pairs ? sums[pairs - 1 - u] : REAL(0.0);
    }
}
#endif

/* in -> out, along u. terms [along u, along v][reach + 1]. */
__kernel void convolve_rows(__global const real *in, __global real *out, __global const real *terms, const int reach,
                            const int pairs, const int pairs_per_strip, const int span) {
    const size_t image = get_global_id(2) * pairs * 4 * span;
    for (int row = FIRST_ROW; row < LAST_ROW; row++) {
        __global const real *from = in + image + (size_t)row * 2 * span;
        __global real *to = out + image + (size_t)row * 2 * span;
#if VEC > 1
        if (2 * (pairs + reach) + VEC <= LONGEST && get_global_size(0) == 1) {
            convolved_row(from, to, terms, reach, pairs, span);
            continue;
        }
#endif
        for (int i = get_global_id(0); i < 2 * span; i += get_global_size(0))
            to[i] = i % span < pairs ? convolved_pixel(from, terms, reach, i / span, i % span, pairs, span) : REAL(0.0);
    }
}

/* in -> out, along v. */
__kernel void convolve_columns(__global const real *in, __global real *out, __global const real *terms, const int reach,
                               const int pairs, const int pairs_per_strip, const int span) {
    const size_t image = get_global_id(2) * pairs * 4 * span;
    __global const real *along_v = terms + reach + 1;
    for (int row = FIRST_ROW; row < LAST_ROW; row++) {
        __global const real *here = in + image + (size_t)row * 2 * span;
        __global real *to = out + image + (size_t)row * 2 * span;
        for (int u = LANE; u < 2 * span; u += LANES) AT(to, u) = SPLAT(along_v[0]) * GET(here, u);
        for (int k = 1; k <= reach; k++) {
            const int below = neighbour(row % 2, row / 2 - k, pairs), above = neighbour(row % 2, row / 2 + k, pairs);
            __global const real *first = in + image + (size_t)(below < 0 ? -2 * below - 1 : 2 * below) * 2 * span;
            __global const real *second = in + image + (size_t)(above < 0 ? -2 * above - 1 : 2 * above) * 2 * span;
            const vec term = SPLAT(along_v[k]);
            for (int u = LANE; u < 2 * span; u += LANES)
                AT(to, u) = MAD(term, GET(first, u) + GET(second, u), GET(to, u));
        }
    }
}

/* -> sums [image][strip * lanes + lane][3]: w h, w h^2, w h d. */
__kernel void intensity_sums(__global const real *intensity, __global const real *data, __global const real *weight,
                             __global const int *slot, __global real *sums, const int first, const int pairs,
                             const int pairs_per_strip, const int span) {
    const size_t image = get_global_id(2), pixel = (size_t)slot[first + image] * pairs * 4 * span;
    __global const real *h = intensity + image * pairs * 4 * span, *d = data + pixel, *w = weight + pixel;
    vec wh = SPLAT(REAL(0.0)), whh = SPLAT(REAL(0.0)), whd = SPLAT(REAL(0.0));
    for (int row = FIRST_ROW; row < LAST_ROW; row++) {
        for (int u = LANE; u < 2 * span; u += LANES) {
            const size_t at = (size_t)row * 2 * span + u;
            vec weighted = GET(w, at) * GET(h, at);
            wh += weighted;
            whh = MAD(weighted, GET(h, at), whh);
            whd = MAD(weighted, GET(d, at), whd);
        }
    }
    __global real *sum =
        sums + ((image * get_global_size(1) + get_global_id(1)) * get_global_size(0) + get_global_id(0)) * 3;
    sum[0] = sum_lanes(wh);
    sum[1] = sum_lanes(whh);
    sum[2] = sum_lanes(whd);
}

/* -> objective [image][strip * lanes + lane], and 2 weight r flux in place of the intensity. */
__kernel void intensity_residuals(__global real *intensity, __global const real *data, __global const real *weight,
                                  __global const int *slot, __global const real *photometry, __global real *objective,
                                  const int first, const int pairs, const int pairs_per_strip, const int span) {
    const size_t image = get_global_id(2), pixel = (size_t)slot[first + image] * pairs * 4 * span;
    __global const real *d = data + pixel, *w = weight + pixel;
    __global real *h = intensity + image * pairs * 4 * span;
    const vec flux = SPLAT(photometry[2 * image]), background = SPLAT(photometry[2 * image + 1]);
    vec sum = SPLAT(REAL(0.0));
    for (int row = FIRST_ROW; row < LAST_ROW; row++) {
        for (int u = LANE; u < 2 * span; u += LANES) {
            const size_t at = (size_t)row * 2 * span + u;
            vec r = MAD(flux, GET(h, at), background - GET(d, at));
            vec wr = GET(w, at) * r;
            sum = MAD(wr, r, sum);
            AT(h, at) = (flux + flux) * wr;
        }
    }
    objective[(image * get_global_size(1) + get_global_id(1)) * get_global_size(0) + get_global_id(0)] = sum_lanes(sum);
}

/* focal -> C' and S' of the field times `scale`, in place. */
__kernel void scale_field(__global real *focal, __global const real *intensity, const int pairs,
                          const int pairs_per_strip, const int span) {
    __global real *f = focal + get_global_id(2) * pairs * 8 * span;
    __global const real *scale = intensity + get_global_id(2) * pairs * 4 * span;
    for (int row = FIRST_ROW; row < LAST_ROW; row++) {
        for (int u = LANE; u < span; u += LANES) {
            __global real *here = f + (size_t)row * 4 * span + u;
            vec re[2], im[2];
            field_of_sides(here, span, re, im);
#pragma unroll
            for (int side = 0; side < 2; side++) {
                const vec s = GET(scale, ((size_t)row * 2 + side) * span + u);
                re[side] *= s;
                im[side] *= s;
            }
            store_source(here, span, re, im);
        }
    }
}
