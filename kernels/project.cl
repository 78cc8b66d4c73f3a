/*
 * project.cl: from the adjoint field in the pupil to the gradient over modes.
 *
 *   g_p = Ebar_p conj(P_p),  P_p = exp(2 pi i t_p)
 *   dJ/dy_j = 2 k sum_p B_jp D_p,  D_p = sum scale Im(conj(E_p) Ebar_p)        k = 2 pi / first wavelength
 *   dJ/dc_s = 2 k sum scale Im(sum_p w_ps conj(q_ps) g_p),  times x_ps or y_ps for tip and tilt (q_ps with them: see field.cl)
 *
 * The sums are over the wavelengths, `scale` is the first over this one; the first sets a sum, the others add to it.
 *
 * pupil_gradient unfolds Ebar, one block and image at a time, into D and g (without 2 k). project_modes multiplies D with
 * the basis over a chunk of blocks, project_segments multiplies g with the weights of a segment; collect adds the chunks and
 * applies 2 k. free_phase_gradient copies D, the gradient by the free phase. focus.cl calls the functions before the kernels
 * too. Every number is written by one work-item, so that no atomics are needed.
 */

/* The four quadrants of a block from its planes: x parity, then y parity, then re and im. */
inline void unfold(__global const real *in, const int width, vec re[4], vec im[4]) {
    vec a = GET(in, 0), b = GET(in, 2 * width), c = GET(in, 4 * width), d = GET(in, 6 * width);
    re[0] = (a + b) + (c + d);
    re[1] = (a + b) - (c + d);
    re[2] = (a - b) + (c - d);
    re[3] = (a - b) - (c - d);
    a = GET(in, width), b = GET(in, 3 * width), c = GET(in, 5 * width), d = GET(in, 7 * width);
    im[0] = (a + b) + (c + d);
    im[1] = (a + b) - (c + d);
    im[2] = (a - b) + (c - d);
    im[3] = (a - b) - (c - d);
}

/* One block of one image: `psi` becomes D, or D of this wavelength is added to it; `phasor` becomes g. `side_rows` as in
   field_block. */
inline void gradient_block(__global const real *field, __global const real *sample_field, __global real *phasor,
                           __global const int *place, __global real *psi, const real scale, const int is_first,
                           const int block, const int blocks, const int width, const int side_rows) {
    vec re[4], im[4];
    if (side_rows) {
#pragma unroll
        for (int q = 0; q < 4; q++) {
            __global const real *in =
                field + ((place[2 * block] + q / 2 * side_rows) * 4 + q % 2 * 2) * width + place[2 * block + 1];
            re[q] = GET(in, 0);
            im[q] = GET(in, width);
        }
    } else
        unfold(field + (size_t)place[2 * block] * 8 * width + place[2 * block + 1], width, re, im);
#pragma unroll
    for (int q = 0; q < 4; q++) {
        const int at_re = COMPLEX(q, block, blocks) * VEC, at_im = at_re + COMPLEX_APART(blocks) * VEC;
        vec cosine = GET(phasor, at_re), sine = GET(phasor, at_im);
        const vec slope = GET(sample_field, at_re) * im[q] - GET(sample_field, at_im) * re[q];
        __global real *total = psi + PLANE(q, block, blocks) * VEC;
        AT(total, 0) = is_first ? slope : MAD(SPLAT(scale), slope, GET(total, 0));
        AT(phasor, at_re) = MAD(re[q], cosine, im[q] * sine);
        AT(phasor, at_im) = im[q] * cosine - re[q] * sine;
    }
}

/* The sum over the wavelengths. */
inline void add_wavelength(__global real *total, const real value, const real scale, const int is_first) {
    *total = is_first ? value : MAD(scale, value, *total);
}

/* One segment of one image: the first `poses` of Im(conj(q) sum_p w g (1, x, y)). The entries of a segment are its weights in
   the blocks that it overlaps; entry_place is COMPLEX(...). `pose` is the segment's [re q, im q, t, u]. */
inline void segment_product(__global const real *phasor, __global const int *segment_entry,
                            __global const int *entry_place, __global const real *entry_weight,
                            __global const real *entry_x, __global const real *entry_y, __global const real *pose,
                            __global real *sum, const real scale, const int is_first, const int start, const int end,
                            const int apart, const int poses) {
    if (poses == 1) {
        vec re = SPLAT(REAL(0.0)), im = SPLAT(REAL(0.0));
        for (int k = start; k < end; k++) {
            const int e = segment_entry[k];
            const vec w = GET(entry_weight, e * VEC);
            __global const real *g = phasor + entry_place[e] * VEC;
            re = MAD(w, GET(g, 0), re);
            im = MAD(w, GET(g, apart * VEC), im);
        }
        add_wavelength(sum, pose[0] * sum_lanes(im) - pose[1] * sum_lanes(re), scale, is_first);
        return;
    }
    vec piston = SPLAT(REAL(0.0)), tip = SPLAT(REAL(0.0)), tilt = SPLAT(REAL(0.0));
    for (int k = start; k < end; k++) {
        const int e = segment_entry[k];
        __global const real *g = phasor + entry_place[e] * VEC;
        const vec x = GET(entry_x, e * VEC), y = GET(entry_y, e * VEC);
        vec sine, cosine;
        sincos_turns(MAD(SPLAT(pose[2]), x, SPLAT(pose[3]) * y), &sine, &cosine);
        const vec re = SPLAT(pose[0]) * cosine - SPLAT(pose[1]) * sine;
        const vec im = MAD(SPLAT(pose[0]), sine, SPLAT(pose[1]) * cosine);
        const vec part = GET(entry_weight, e * VEC) * (re * GET(g, apart * VEC) - im * GET(g, 0));
        piston += part;
        tip = MAD(part, x, tip);
        tilt = MAD(part, y, tilt);
    }
    add_wavelength(sum, sum_lanes(piston), scale, is_first);
    add_wavelength(sum + 1, sum_lanes(tip), scale, is_first);
    add_wavelength(sum + 2, sum_lanes(tilt), scale, is_first);
}

/* field -> D in place of psi, and g in place of phasor: global (any, images, 1). */
__kernel void pupil_gradient(__global const real *field, __global const real *sample_field, __global real *phasor,
                             __global const int *place, __global real *psi, const int blocks, const int rows,
                             const int width, const real scale, const int is_first) {
    const size_t image = get_global_id(1), quads = (size_t)blocks * 4 * VEC;
    for (int block = get_global_id(0); block < blocks; block += get_global_size(0))
        gradient_block(field + image * rows * 8 * width, sample_field + 2 * image * quads, phasor + 2 * image * quads, place,
                       psi + image * quads, scale, is_first, block, blocks, width, 0);
}

/* g (in phasor) -> segment_sum [image][segment][poses]: global (segments, images, 1). */
__kernel void project_segments(__global const real *phasor, __global const int *segment_start,
                               __global const int *segment_entry, __global const int *entry_place,
                               __global const real *entry_weight, __global const real *entry_x,
                               __global const real *entry_y, __global const real *pose, __global real *segment_sum,
                               const int segments, const int blocks, const int first, const int poses,
                               const real scale, const int is_first) {
    const int segment = get_global_id(0);
    const size_t image = get_global_id(1);
    if (segment >= segments) return;
    segment_product(phasor + image * blocks * 8 * VEC, segment_entry, entry_place, entry_weight, entry_x, entry_y,
                    pose + ((first + image) * segments + segment) * 4, segment_sum + (image * segments + segment) * poses,
                    scale, is_first, segment_start[segment], segment_start[segment + 1], COMPLEX_APART(blocks), poses);
}

/* D (in psi) -> mode_partial [image][chunk][padded modes]: global (mode groups, chunks, any); on a GPU (chunks, mode groups, any), with
   the blocks `chunks` apart, so that neighbouring work-items read neighbouring blocks. A work-item holds 4 modes x GROUP images of
   vector sums over its chunk of blocks. Precondition: `images` is a multiple of GROUP. */
__kernel void project_modes(__global const real *basis, __global const real *psi, __global real *mode_partial,
                            const int blocks, const int groups, const int chunks, const int blocks_per_chunk,
                            const int images, const int block_stride, const int mode_stride,
                            const int quadrant_stride) {
#if VEC == 1
    const int chunk = get_global_id(0), group = get_global_id(1), start = chunk, end = blocks, step = chunks;
#else
    const int group = get_global_id(0), chunk = get_global_id(1), start = chunk * blocks_per_chunk, step = 1;
    const int end = min(blocks, start + blocks_per_chunk);
#endif
    if (group >= groups || chunk >= chunks) return;
    for (int image = get_global_id(2) * GROUP; image < images; image += get_global_size(2) * GROUP) {
        vec sum[4][GROUP];
#pragma unroll
        for (int j = 0; j < 4; j++)
#pragma unroll
            for (int i = 0; i < GROUP; i++) sum[j][i] = SPLAT(REAL(0.0));
        for (int block = start; block < end; block += step) {
            for (int q = 0; q < 4; q++) {
                __global const real *b =
                    basis + (size_t)block * block_stride + (size_t)group * 4 * mode_stride + q * quadrant_stride;
                __global const real *d = psi + ((size_t)image * blocks * 4 + PLANE(q, block, blocks)) * VEC;
                vec shape[4];
#pragma unroll
                for (int j = 0; j < 4; j++) shape[j] = GET(b, j * mode_stride);
#pragma unroll
                for (int i = 0; i < GROUP; i++) {
                    vec amount = GET(d, (size_t)i * 4 * blocks * VEC);
#pragma unroll
                    for (int j = 0; j < 4; j++) sum[j][i] = MAD(shape[j], amount, sum[j][i]);
                }
            }
        }
#pragma unroll
        for (int i = 0; i < GROUP; i++)
#pragma unroll
            for (int j = 0; j < 4; j++)
                mode_partial[((size_t)(image + i) * chunks + chunk) * groups * 4 + group * 4 + j] =
                    sum_lanes(sum[j][i]);
    }
}

/* D (in psi) -> free [image][illuminated sample], per turn: global (any, images, 1). */
__kernel void free_phase_gradient(__global const real *psi, __global real *free, __global const int *sample_place,
                                  const int first, const int samples, const int blocks, const real twice_turn) {
    const size_t image = get_global_id(1);
    __global const real *d = psi + image * blocks * 4 * VEC;
    __global real *f = free + (first + image) * samples;
    for (int p = get_global_id(0); p < samples; p += get_global_size(0)) f[p] = twice_turn * d[sample_place[p]];
}

/* -> result [image][objective, flux, background, poses of each segment..., smooth modes...]: global (any, images, 1). */
__kernel void collect(__global const real *mode_partial, __global const real *segment_sum,
                      __global const real *objective, __global const real *photometry, __global real *result,
                      const int first, const int pose_outputs, const int smooth, const int padded_modes, const int chunks,
                      const int partials, const real twice_wavenumber) {
    const int image = get_global_id(1), outputs = 3 + pose_outputs + smooth;
    for (int output = get_global_id(0); output < outputs; output += get_global_size(0)) {
        wide value = 0;
        if (output == 0) {
            for (int i = 0; i < partials; i++) value += objective[(size_t)image * partials + i];
        } else if (output < 3) {
            value = photometry[2 * image + output - 1];
        } else if (output < 3 + pose_outputs) {
            value = twice_wavenumber * segment_sum[(size_t)image * pose_outputs + output - 3];
        } else {
            const int mode = output - 3 - pose_outputs;
            for (int c = 0; c < chunks; c++) value += mode_partial[((size_t)image * chunks + c) * padded_modes + mode];
            value *= twice_wavenumber;
        }
        result[(size_t)(first + image) * outputs + output] = value;
    }
}
