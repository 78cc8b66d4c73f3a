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
 * The functions before the kernels process the rows `row` to `end` of one image; focus.cl calls them too. All kernels: global
 * (lanes, strips, images).
 */

/* intensity (+)= |U|^2. */
inline void add_strip_intensity(__global const real *focal, __global real *intensity, int row, const int end,
                                const int lane, const int lanes, const int span, const int is_first) {
    for (; row < end; row++) {
        for (int u = lane * VEC; u < span; u += lanes * VEC) {
            vec re[2], im[2];
            field_of_sides(focal + (size_t)row * 4 * span + u, span, re, im);
#pragma unroll
            for (int side = 0; side < 2; side++) {
                __global real *pixel = intensity + ((size_t)row * 2 + side) * span + u;
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
inline void convolve_strip_rows(__global const real *in, __global real *out, __global const real *terms, const int reach,
                                int row, const int end, const int lane, const int lanes, const int pairs,
                                const int span) {
    for (; row < end; row++) {
        __global const real *from = in + (size_t)row * 2 * span;
        __global real *to = out + (size_t)row * 2 * span;
#if VEC > 1
        if (2 * (pairs + reach) + VEC <= LONGEST && lanes == 1) {
            convolved_row(from, to, terms, reach, pairs, span);
            continue;
        }
#endif
        for (int i = lane; i < 2 * span; i += lanes)
            to[i] = i % span < pairs ? convolved_pixel(from, terms, reach, i / span, i % span, pairs, span) : REAL(0.0);
    }
}

/* in -> out, along v. */
inline void convolve_strip_columns(__global const real *in, __global real *out, __global const real *terms,
                                   const int reach, int row, const int end, const int lane, const int lanes,
                                   const int pairs, const int span) {
    __global const real *along_v = terms + reach + 1;
    for (; row < end; row++) {
        __global real *to = out + (size_t)row * 2 * span;
        for (int u = lane * VEC; u < span; u += lanes * VEC) {
            __global const real *here = in + (size_t)row * 2 * span + u;
            vec sum[2] = {SPLAT(along_v[0]) * GET(here, 0), SPLAT(along_v[0]) * GET(here, span)};
            for (int k = 1; k <= reach; k++) {
                const int below = neighbour(row % 2, row / 2 - k, pairs), above = neighbour(row % 2, row / 2 + k, pairs);
                __global const real *first = in + (size_t)(below < 0 ? -2 * below - 1 : 2 * below) * 2 * span + u;
                __global const real *second = in + (size_t)(above < 0 ? -2 * above - 1 : 2 * above) * 2 * span + u;
                const vec term = SPLAT(along_v[k]);
#pragma unroll
                for (int side = 0; side < 2; side++)
                    sum[side] = MAD(term, GET(first, side * span) + GET(second, side * span), sum[side]);
            }
            AT(to, u) = sum[0];
            AT(to, span + u) = sum[1];
        }
    }
}

/* The convolution of a whole image along both axes, in place, by one work-item. */
inline void convolve_image(__global real *intensity, __global real *convolved, __global const real *terms,
                           const int reach, const int pairs, const int span) {
    convolve_strip_rows(intensity, convolved, terms, reach, 0, 2 * pairs, 0, 1, pairs, span);
    convolve_strip_columns(convolved, intensity, terms, reach, 0, 2 * pairs, 0, 1, pairs, span);
}

/* Sums of w h, w h^2, w h d. */
inline void intensity_strip_sums(__global const real *intensity, __global const real *data, __global const real *weight,
                                 int row, const int end, const int lane, const int lanes, const int span,
                                 __global real *sums) {
    vec wh = SPLAT(REAL(0.0)), whh = SPLAT(REAL(0.0)), whd = SPLAT(REAL(0.0));
    for (; row < end; row++) {
        for (int u = lane * VEC; u < 2 * span; u += lanes * VEC) {
            const size_t at = (size_t)row * 2 * span + u;
            vec h = GET(intensity, at), weighted = GET(weight, at) * h;
            wh += weighted;
            whh = MAD(weighted, h, whh);
            whd = MAD(weighted, GET(data, at), whd);
        }
    }
    sums[0] = sum_lanes(wh);
    sums[1] = sum_lanes(whh);
    sums[2] = sum_lanes(whd);
}

/* Objective; 2 weight r flux replaces the intensity. */
inline real intensity_strip_residuals(__global real *intensity, __global const real *data, __global const real *weight,
                                      int row, const int end, const int lane, const int lanes, const int span,
                                      __global const real *photometry) {
    const vec flux = SPLAT(photometry[0]), background = SPLAT(photometry[1]), twice_flux = flux + flux;
    vec sum = SPLAT(REAL(0.0));
    for (; row < end; row++) {
        for (int u = lane * VEC; u < 2 * span; u += lanes * VEC) {
            const size_t at = (size_t)row * 2 * span + u;
            vec r = MAD(flux, GET(intensity, at), background - GET(data, at));
            vec wr = GET(weight, at) * r;
            sum = MAD(wr, r, sum);
            AT(intensity, at) = twice_flux * wr;
        }
    }
    return sum_lanes(sum);
}

/* focal -> C' and S' of the field times `scale` (as the intensity), in place. */
inline void scale_strip(__global real *focal, __global const real *scale, int row, const int end, const int lane,
                        const int lanes, const int span) {
    for (; row < end; row++) {
        for (int u = lane * VEC; u < span; u += lanes * VEC) {
            __global real *here = focal + (size_t)row * 4 * span + u;
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

/* This work-item's rows and its share of them. */
#define IMAGE ((size_t)get_global_id(2))
#define FIRST_ROW (2 * (int)get_global_id(1) * pairs_per_strip)
#define END_ROW (2 * min(pairs, ((int)get_global_id(1) + 1) * pairs_per_strip))
#define LANE ((int)get_global_id(0))
#define LANES ((int)get_global_size(0))
/* Index of this work-item's partial sum. */
#define PARTIAL ((IMAGE * get_global_size(1) + get_global_id(1)) * LANES + LANE)

__kernel void add_intensity(__global const real *focal, __global real *intensity, const int pairs,
                            const int pairs_per_strip, const int span, const int is_first) {
    add_strip_intensity(focal + IMAGE * pairs * 8 * span, intensity + IMAGE * pairs * 4 * span, FIRST_ROW, END_ROW, LANE,
                        LANES, span, is_first);
}

__kernel void convolve_rows(__global const real *in, __global real *out, __global const real *terms, const int reach,
                            const int pairs, const int pairs_per_strip, const int span) {
    const size_t image = IMAGE * pairs * 4 * span;
    convolve_strip_rows(in + image, out + image, terms, reach, FIRST_ROW, END_ROW, LANE, LANES, pairs, span);
}

__kernel void convolve_columns(__global const real *in, __global real *out, __global const real *terms, const int reach,
                               const int pairs, const int pairs_per_strip, const int span) {
    const size_t image = IMAGE * pairs * 4 * span;
    convolve_strip_columns(in + image, out + image, terms, reach, FIRST_ROW, END_ROW, LANE, LANES, pairs, span);
}

/* -> sums [image][strip * lanes + lane][3]. */
__kernel void intensity_sums(__global const real *intensity, __global const real *data, __global const real *weight,
                             __global const int *slot, __global real *sums, const int first, const int pairs,
                             const int pairs_per_strip, const int span) {
    const size_t pixel = (size_t)slot[first + IMAGE] * pairs * 4 * span;
    intensity_strip_sums(intensity + IMAGE * pairs * 4 * span, data + pixel, weight + pixel, FIRST_ROW, END_ROW, LANE,
                         LANES, span, sums + PARTIAL * 3);
}

/* -> objective [image][strip * lanes + lane], and 2 weight r flux in place of the intensity. */
__kernel void intensity_residuals(__global real *intensity, __global const real *data, __global const real *weight,
                                  __global const int *slot, __global const real *photometry, __global real *objective,
                                  const int first, const int pairs, const int pairs_per_strip, const int span) {
    const size_t pixel = (size_t)slot[first + IMAGE] * pairs * 4 * span;
    objective[PARTIAL] = intensity_strip_residuals(intensity + IMAGE * pairs * 4 * span, data + pixel, weight + pixel,
                                                   FIRST_ROW, END_ROW, LANE, LANES, span, photometry + 2 * IMAGE);
}

__kernel void scale_field(__global real *focal, __global const real *intensity, const int pairs,
                          const int pairs_per_strip, const int span) {
    scale_strip(focal + IMAGE * pairs * 8 * span, intensity + IMAGE * pairs * 4 * span, FIRST_ROW, END_ROW, LANE, LANES,
                span);
}
