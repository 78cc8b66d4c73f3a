/*
 * field.cl: from mode coefficients to the field in the pupil, folded for the transform.
 *
 *   psi_p = diversity_p + sum_j B_jp y_j                     in turns of the first wavelength (y_j = coefficient / wavelength)
 *   t_p   = scale psi_p + excess_p                           in turns of each wavelength; psi_p at the first
 *   a_p   = sum_s w_ps q_s exp(2 pi i (t_s x_ps + u_s y_ps)) q_s = the phasor of segment s, scaled so that |focal field|^2
 *                                                            is the PSF; t_s, u_s its tip and tilt in turns
 *   E_p   = a_p exp(2 pi i t_p)
 *
 * The wavelengths share one psi, so that the products with the modes do not grow with their number: `scale` is the first
 * wavelength over this one, `excess` the diversity of this one without scale times that of the first.
 *
 * smooth_phase is a matrix product over all images of a tile: one work-item per pupil block and, on a GPU, per GROUP
 * images. The four quadrants of a block times GROUP images are 16 accumulators; each step of the loop over
 * modes reads 4 vectors of the basis and GROUP coefficients for 16 multiply-adds. On a CPU one work-item processes all images
 * of the tile, so that its slice of the basis (modes x 4 vectors) stays in the first-level cache; it writes psi only.
 *
 * add_free_phase adds the free phase, one number per illuminated sample, where the model has one; free_phase_gradient of
 * project.cl is its adjoint.
 *
 * field_block processes one block of one image: for pupil_field, or as a part of focus.cl. The phasors exp(2 pi i t) and the
 * field are also stored for the adjoint, as [quadrant, block][re, im] (COMPLEX in common.cl).
 *
 * `poses` is the number of degrees of freedom of a segment: 1 for piston (the phasor q), 3 for piston, tip and tilt.
 */

/* sin and cos of 2 pi t. The argument is reduced to |t - k/2| <= 1/4, where the minimax polynomials have errors of 3e-8
   (float, 5 and 6 terms) and 7e-21 (double, 10 and 10), below the rounding of either type. The built-in sincos would cost more
   than the whole transform on a CPU. */
inline void sincos_turns(vec t, vec *sine, vec *cosine) {
    vec half_turns = rint(t + t);
    vec r = MAD(half_turns, SPLAT(REAL(-0.5)), t);
    vec parity = half_turns - SPLAT(REAL(2.0)) * rint(SPLAT(REAL(0.5)) * half_turns);
    vec sign = MAD(SPLAT(REAL(-2.0)) * parity, parity, SPLAT(REAL(1.0)));
    vec z = r * r;
#if DOUBLE
    vec s = SPLAT(-0.011683082881307492416);
    s = MAD(s, z, SPLAT(0.10418309087064648376));
    s = MAD(s, z, SPLAT(-0.71811892189106583204));
    s = MAD(s, z, SPLAT(3.8199524348668090197));
    s = MAD(s, z, SPLAT(-15.094642572701974217));
    s = MAD(s, z, SPLAT(42.058693944828701411));
    s = MAD(s, z, SPLAT(-76.70585975306072309));
    s = MAD(s, z, SPLAT(81.605249276075050968));
    s = MAD(s, z, SPLAT(-41.341702240399760228));
    s = MAD(s, z, SPLAT(6.2831853071795864769));
    vec c = SPLAT(-0.035219604638146758369);
    c = MAD(c, z, SPLAT(0.28185225938435092808));
    c = MAD(c, z, SPLAT(-1.7143794371382703398));
    c = MAD(c, z, SPLAT(7.9035358711039378802));
    c = MAD(c, z, SPLAT(-26.426256769631195169));
    c = MAD(c, z, SPLAT(60.244641371646725096));
    c = MAD(c, z, SPLAT(-85.456817206691517718));
    c = MAD(c, z, SPLAT(64.939394022668280703));
    c = MAD(c, z, SPLAT(-19.739208802178717217));
    c = MAD(c, z, SPLAT(1.0));
#else
    vec s = SPLAT(39.759827085f);
    s = MAD(s, z, SPLAT(-76.581172645f));
    s = MAD(s, z, SPLAT(81.602476369f));
    s = MAD(s, z, SPLAT(-41.341680613f));
    s = MAD(s, z, SPLAT(6.2831852802f));
    vec c = SPLAT(-24.981434468f);
    c = MAD(c, z, SPLAT(60.143889560f));
    c = MAD(c, z, SPLAT(-85.453564761f));
    c = MAD(c, z, SPLAT(64.939346476f));
    c = MAD(c, z, SPLAT(-19.739208548f));
    c = MAD(c, z, SPLAT(1.0f));
#endif
    *sine = sign * r * s;
    *cosine = sign * c;
}

/* -> psi [image][quadrant, block][VEC]. Precondition: `images` is a multiple of GROUP. `first` is the tile's first image
   in coefficients. */
__kernel void smooth_phase(__global const real *basis, __global const real *diversity,
                           __global const real *coefficients, __global real *psi, const int blocks, const int modes,
                           const int images, const int first, const int block_stride, const int mode_stride,
                           const int quadrant_stride) {
    const int block = get_global_id(0);
    if (block >= blocks) return;
    for (int group = get_global_id(1) * GROUP; group < images; group += get_global_size(1) * GROUP) {
        vec sum[GROUP][4];
#pragma unroll
        for (int q = 0; q < 4; q++) {
            vec d = GET(diversity, PLANE(q, block, blocks) * VEC);
#pragma unroll
            for (int i = 0; i < GROUP; i++) sum[i][q] = d;
        }
        __global const real *b = basis + (size_t)block * block_stride;
        __global const real *c = coefficients + (size_t)(first + group) * modes;
        for (int mode = 0; mode < modes; mode++, b += mode_stride) {
            vec shape[4];
#pragma unroll
            for (int q = 0; q < 4; q++) shape[q] = GET(b, q * quadrant_stride);
#pragma unroll
            for (int i = 0; i < GROUP; i++) {
                vec amount = SPLAT(c[i * modes + mode]);
#pragma unroll
                for (int q = 0; q < 4; q++) sum[i][q] = MAD(shape[q], amount, sum[i][q]);
            }
        }
#pragma unroll
        for (int i = 0; i < GROUP; i++)
#pragma unroll
            for (int q = 0; q < 4; q++)
                AT(psi, ((size_t)(group + i) * blocks * 4 + PLANE(q, block, blocks)) * VEC) = sum[i][q];
    }
}

/* psi += scale free [image][illuminated sample], turns, at index `sample_place` of the image's psi: global (any, images, 1). The
   scale is the wavelength of the free phase over that of psi. */
__kernel void add_free_phase(__global real *psi, __global const real *free, __global const int *sample_place, const int first,
                             const int samples, const int blocks, const real scale) {
    const size_t image = get_global_id(1);
    __global real *t = psi + image * blocks * 4 * VEC;
    __global const real *f = free + (first + image) * samples;
    for (int p = get_global_id(0); p < samples; p += get_global_size(0)) t[sample_place[p]] = MAD(scale, f[p], t[sample_place[p]]);
}

/* Phasor, field and folded field of one block of one image at one wavelength; `pose` is its [segment][re q, im q, t, u].
   `excess` is 0 for the only wavelength of a model. With `side_rows` > 0 the field is not folded but stored in the layout of
   fft.cl. */
inline void field_block(__global const real *psi, __global const real *excess, const real scale,
                        __global const int *place, __global const int *entry_start,
                        __global const int *entry_segment, __global const real *entry_weight,
                        __global const real *entry_x, __global const real *entry_y, __global const real *pose,
                        __global real *phasor, __global real *sample_field, __global real *field, const int block,
                        const int blocks, const int width, const int poses, const int side_rows) {
    vec er[4], ei[4];
#pragma unroll
    for (int q = 0; q < 4; q++) {
        vec sine, cosine, turns = GET(psi, PLANE(q, block, blocks) * VEC);
        if (excess) turns = MAD(SPLAT(scale), turns, GET(excess, PLANE(q, block, blocks) * VEC));
        sincos_turns(turns, &sine, &cosine);
        vec ar = SPLAT(REAL(0.0)), ai = SPLAT(REAL(0.0));
        for (int e = entry_start[4 * block + q]; e < entry_start[4 * block + q + 1]; e++) {
            vec w = GET(entry_weight, e * VEC);
            __global const real *s = pose + 4 * entry_segment[e];
            if (poses == 1) {
                ar = MAD(w, SPLAT(s[0]), ar);
                ai = MAD(w, SPLAT(s[1]), ai);
            } else {
                vec im, re;
                sincos_turns(MAD(SPLAT(s[2]), GET(entry_x, e * VEC), SPLAT(s[3]) * GET(entry_y, e * VEC)), &im, &re);
                ar = MAD(w, SPLAT(s[0]) * re - SPLAT(s[1]) * im, ar);
                ai = MAD(w, MAD(SPLAT(s[0]), im, SPLAT(s[1]) * re), ai);
            }
        }
        er[q] = ar * cosine - ai * sine;
        ei[q] = MAD(ar, sine, ai * cosine);
        const int at = COMPLEX(q, block, blocks) * VEC, apart = COMPLEX_APART(blocks) * VEC;
        AT(phasor, at) = cosine;
        AT(phasor, at + apart) = sine;
        AT(sample_field, at) = er[q];
        AT(sample_field, at + apart) = ei[q];
    }
    if (side_rows) {
#pragma unroll
        for (int q = 0; q < 4; q++) {
            __global real *out =
                field + ((place[2 * block] + q / 2 * side_rows) * 4 + q % 2 * 2) * width + place[2 * block + 1];
            AT(out, 0) = er[q];
            AT(out, width) = ei[q];
        }
        return;
    }
    __global real *out = field + (size_t)place[2 * block] * 8 * width + place[2 * block + 1];
    AT(out, 0 * width) = (er[0] + er[1]) + (er[2] + er[3]);
    AT(out, 1 * width) = (ei[0] + ei[1]) + (ei[2] + ei[3]);
    AT(out, 2 * width) = (er[0] + er[1]) - (er[2] + er[3]);
    AT(out, 3 * width) = (ei[0] + ei[1]) - (ei[2] + ei[3]);
    AT(out, 4 * width) = (er[0] - er[1]) + (er[2] - er[3]);
    AT(out, 5 * width) = (ei[0] - ei[1]) + (ei[2] - ei[3]);
    AT(out, 6 * width) = (er[0] - er[1]) - (er[2] - er[3]);
    AT(out, 7 * width) = (ei[0] - ei[1]) - (ei[2] - ei[3]);
}

/* psi -> phasor, sample_field, field: global (blocks, images, 1). */
__kernel void pupil_field(__global const real *psi, __global const real *excess, __global const int *place,
                          __global const int *entry_start,
                          __global const int *entry_segment, __global const real *entry_weight,
                          __global const real *entry_x, __global const real *entry_y, __global const real *pose,
                          __global real *phasor, __global real *sample_field, __global real *field, const int first,
                          const int blocks, const int segments, const int rows, const int width, const int poses,
                          const real scale) {
    const int block = get_global_id(0);
    const size_t image = get_global_id(1), quads = (size_t)blocks * 4 * VEC;
    if (block >= blocks) return;
    field_block(psi + image * quads, excess, scale, place, entry_start, entry_segment, entry_weight, entry_x, entry_y,
                pose + (first + image) * segments * 4, phasor + 2 * image * quads, sample_field + 2 * image * quads,
                field + image * rows * 8 * width, block, blocks, width, poses, 0);
}
