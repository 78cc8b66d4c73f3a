/*
 * project.cl: from the adjoint field in the pupil to the gradient over modes.
 *
 *   g_p = Ebar_p conj(P_p),  P_p = exp(2 pi i psi_p)
 *   dJ/dy_j = sum_p B_jp D_p,  D_p = 2 k Im(conj(a_p) g_p)                     k = 2 pi / wavelength
 *   dJ/dc_s = 2 k Im(conj(q_s) sum_p w_ps g_p)
 *
 * pupil_gradient unfolds Ebar, one block and image per work-item, and leaves D (without 2 k) and, for every entry of the
 * segment list, its complex sum over the block. project_modes multiplies D with the basis over a chunk of blocks;
 * collect adds what the chunks and entries left and applies 2 k. Every number has one writer: no atomics.
 */

/* field -> slope [image][quadrant][block][VEC], segment_partial [image][entry][2]: global (any, images, 1). */
__kernel void pupil_gradient(__global const real *field, __global const real *phasor, __global const int *place,
                             __global const int *entry_start, __global const int *entry_segment,
                             __global const real *entry_weight, __global const real *segment_phasor,
                             __global real *slope, __global real *segment_partial, const int blocks, const int segments,
                             const int entries, const int first, const int rows, const int width) {
    const int image = get_global_id(1);
    __global const real *p = phasor + (size_t)image * blocks * (8 * VEC);
    __global const real *piston = segment_phasor + (size_t)(first + image) * segments * 2;
    __global real *partial = segment_partial + (size_t)image * entries * 2;

    for (int block = get_global_id(0); block < blocks; block += get_global_size(0)) {
        const int y = place[2 * block], x = place[2 * block + 1];
        __global const real *in = field + ((size_t)(image * rows + y) * 8) * width + x;

        /* Planes: x parity, then y parity, then re and im. */
        vec re[4], im[4];
        {
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
#pragma unroll
        for (int q = 0; q < 4; q++) {
            vec cosine = GET(p, (2 * q * blocks + block) * VEC), sine = GET(p, ((2 * q + 1) * blocks + block) * VEC);
            vec gr = MAD(re[q], cosine, im[q] * sine), gi = im[q] * cosine - re[q] * sine;
            vec ar = SPLAT(REAL(0.0)), ai = SPLAT(REAL(0.0));
            for (int e = entry_start[4 * block + q]; e < entry_start[4 * block + q + 1]; e++) {
                vec w = GET(entry_weight, e * VEC);
                const int s = 2 * entry_segment[e];
                ar = MAD(w, SPLAT(piston[s]), ar);
                ai = MAD(w, SPLAT(piston[s + 1]), ai);
                partial[2 * e] = sum_lanes(w * gr);
                partial[2 * e + 1] = sum_lanes(w * gi);
            }
            AT(slope, ((size_t)(image * 4 + q) * blocks + block) * VEC) = ar * gi - ai * gr;
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
__kernel void collect(__global const real *mode_partial, __global const real *segment_partial,
                      __global const int *segment_start, __global const int *segment_entry,
                      __global const real *segment_phasor, __global const real *objective,
                      __global const real *photometry, __global real *result, const int first, const int segments,
                      const int smooth, const int padded_modes, const int chunks, const int entries, const int partials,
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
            wide re = 0, im = 0;
            for (int i = segment_start[s]; i < segment_start[s + 1]; i++) {
                const size_t e = ((size_t)image * entries + segment_entry[i]) * 2;
                re += segment_partial[e];
                im += segment_partial[e + 1];
            }
            __global const real *q = segment_phasor + ((size_t)(first + image) * segments + s) * 2;
            value = twice_wavenumber * (q[0] * im - q[1] * re);
        } else {
            const int mode = output - 3 - segments;
            for (int c = 0; c < chunks; c++) value += mode_partial[((size_t)image * chunks + c) * padded_modes + mode];
            value *= twice_wavenumber;
        }
        result[(size_t)(first + image) * outputs + output] = value;
    }
}
