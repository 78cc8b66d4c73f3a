/*
 * project.cl: from the adjoint field in the pupil to the gradient over modes.
 *
 *   g_p = Ebar_p conj(P_p),  P_p = exp(2 pi i psi_p)
 *   dJ/dy_j = sum_p B_jp D_p,  D_p = 2 k Im(conj(E_p) Ebar_p)                  k = 2 pi / wavelength
 *   dJ/dc_s = 2 k Im(conj(q_s) sum_p w_ps g_p)
 *
 * pupil_gradient unfolds Ebar, one block and image at a time, into D and g (without 2 k). project_modes multiplies D with
 * the basis over a chunk of blocks, project_segments g with the weights of a segment; collect adds what the chunks left
 * and applies 2 k. Every number has one writer: no atomics.
 */

/* field -> slope D [image][quadrant][block][VEC], and g in place of phasor: global (any, images, 1). */
__kernel void pupil_gradient(__global const real *field, __global const real *lit_field, __global real *phasor,
                             __global const int *place, __global real *slope, const int blocks, const int rows,
                             const int width) {
    const int image = get_global_id(1);
    __global real *p = phasor + (size_t)image * blocks * (8 * VEC);
    __global const real *l = lit_field + (size_t)image * blocks * (8 * VEC);
    for (int block = get_global_id(0); block < blocks; block += get_global_size(0)) {
        const int y = place[2 * block], x = place[2 * block + 1];
        __global const real *in = field + ((size_t)(image * rows + y) * 8) * width + x;

        /* Planes: x parity, then y parity, then re and im. */
        vec re[4], im[4];
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
#pragma unroll
        for (int q = 0; q < 4; q++) {
            const int at_re = (2 * q * blocks + block) * VEC, at_im = at_re + blocks * VEC;
            vec cosine = GET(p, at_re), sine = GET(p, at_im);
            AT(slope, ((size_t)(image * 4 + q) * blocks + block) * VEC) = GET(l, at_re) * im[q] - GET(l, at_im) * re[q];
            AT(p, at_re) = MAD(re[q], cosine, im[q] * sine);
            AT(p, at_im) = im[q] * cosine - re[q] * sine;
        }
    }
}

/* g (in phasor) -> segment_sum [image][segment][re, im]: global (segments, any, 1). The entries of a segment are its
   weights in the blocks that it touches, entry_place = 2 quadrant blocks + block. Precondition: `images` is a multiple
   of GROUP. */
__kernel void project_segments(__global const real *phasor, __global const int *segment_start,
                               __global const int *segment_entry, __global const int *entry_place,
                               __global const real *entry_weight, __global real *segment_sum, const int segments,
                               const int images, const int blocks) {
    const int segment = get_global_id(0);
    if (segment >= segments) return;
    for (int image = get_global_id(1) * GROUP; image < images; image += get_global_size(1) * GROUP) {
        vec re[GROUP], im[GROUP];
#pragma unroll
        for (int i = 0; i < GROUP; i++) re[i] = im[i] = SPLAT(REAL(0.0));
        for (int k = segment_start[segment]; k < segment_start[segment + 1]; k++) {
            const int e = segment_entry[k];
            const vec w = GET(entry_weight, e * VEC);
            __global const real *g = phasor + ((size_t)image * blocks * 8 + entry_place[e]) * VEC;
#pragma unroll
            for (int i = 0; i < GROUP; i++, g += blocks * 8 * VEC) {
                re[i] = MAD(w, GET(g, 0), re[i]);
                im[i] = MAD(w, GET(g, blocks * VEC), im[i]);
            }
        }
#pragma unroll
        for (int i = 0; i < GROUP; i++) {
            __global real *out = segment_sum + ((size_t)(image + i) * segments + segment) * 2;
            out[0] = sum_lanes(re[i]);
            out[1] = sum_lanes(im[i]);
        }
    }
}

/* slope -> mode_partial [image][chunk][padded modes]: global (mode groups, chunks, any). A work-item holds 4 modes x
   GROUP images of vector sums over its chunk of blocks. Precondition: `images` is a multiple of GROUP. */
__kernel void project_modes(__global const real *basis, __global const real *slope, __global real *mode_partial,
                            const int blocks, const int groups, const int blocks_per_chunk, const int images,
                            const int block_stride, const int mode_stride, const int quadrant_stride) {
    const int group = get_global_id(0), chunk = get_global_id(1), chunks = get_global_size(1);
    if (group >= groups) return;
    const int end = min(blocks, (chunk + 1) * blocks_per_chunk);
    for (int image = get_global_id(2) * GROUP; image < images; image += get_global_size(2) * GROUP) {
        vec sum[4][GROUP];
#pragma unroll
        for (int j = 0; j < 4; j++)
#pragma unroll
            for (int i = 0; i < GROUP; i++) sum[j][i] = SPLAT(REAL(0.0));
        for (int block = chunk * blocks_per_chunk; block < end; block++) {
            for (int q = 0; q < 4; q++) {
                __global const real *b =
                    basis + (size_t)block * block_stride + (size_t)group * 4 * mode_stride + q * quadrant_stride;
                __global const real *d = slope + ((size_t)(image * 4 + q) * blocks + block) * VEC;
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

/* -> result [image][objective, flux, background, segments..., smooth modes...]: global (any, images, 1). */
__kernel void collect(__global const real *mode_partial, __global const real *segment_sum,
                      __global const real *segment_phasor, __global const real *objective,
                      __global const real *photometry, __global real *result, const int first, const int segments,
                      const int smooth, const int padded_modes, const int chunks, const int partials,
                      const real twice_wavenumber) {
    const int image = get_global_id(1), outputs = 3 + segments + smooth;
    for (int output = get_global_id(0); output < outputs; output += get_global_size(0)) {
        wide value = 0;
        if (output == 0) {
            for (int i = 0; i < partials; i++) value += objective[(size_t)image * partials + i];
        } else if (output < 3) {
            value = photometry[2 * image + output - 1];
        } else if (output < 3 + segments) {
            const int s = output - 3;
            __global const real *sum = segment_sum + ((size_t)image * segments + s) * 2;
            __global const real *q = segment_phasor + ((size_t)(first + image) * segments + s) * 2;
            value = twice_wavenumber * (q[0] * sum[1] - q[1] * sum[0]);
        } else {
            const int mode = output - 3 - segments;
            for (int c = 0; c < chunks; c++) value += mode_partial[((size_t)image * chunks + c) * padded_modes + mode];
            value *= twice_wavenumber;
        }
        result[(size_t)(first + image) * outputs + output] = value;
    }
}
