/*
 * focus.cl: from the phase of an image to its objective and to the gradient by the phase, in one kernel: pupil_field to
 * project_segments with the same arithmetic in the same order. For a CPU with at least one image per core.
 *
 * A work-item processes whole images, one after the other, in arrays of its own (field, phasor, sample_field, wave, focal),
 * which stay in the second-level cache of its core; only psi, data and weights are read from memory, and only D is written.
 * The rows of a strip are transformed and summed, and later subtracted and transformed back, while they are in the cache.
 *
 * global (workers, 1, 1), local (1, 1, 1). A worker takes the next unprocessed image by incrementing the counter next[tile],
 * which is 0 before the launch: OpenCL does not define how work-items are distributed over cores (PoCL assigns too many to the
 * first core), and a core may be busy with another program. There are two or more workers per core, so that each core has one;
 * late workers find no image and return. The results do not depend on which worker processes an image.
 * The adjoint overwrites `field`.
 */
__kernel void focus(__global real *psi, __global const int *place, __global const int *entry_start,
                    __global const int *entry_segment, __global const real *entry_weight,
                    __global const real *entry_x, __global const real *entry_y, __global const int *segment_start,
                    __global const int *segment_entry, __global const int *entry_place, __global const real *pose,
                    __global real *phasor, __global real *sample_field, __global real *field,
                    __global const real *y_to_v, __global const real *x_to_u, __global const real *u_to_x,
                    __global const real *v_to_y, __global const int *extent, __global real *wave, __global real *focal,
                    __global const real *data, __global const real *weight, __global const int *slot,
                    __global const int *kind, __global const real *known, __global real *sums,
                    __global real *objective, __global real *photometry, __global real *segment_sum,
                    volatile __global int *next, const int tile, const int first, const int images, const int blocks,
                    const int segments, const int poses, const int rows, const int pairs, const int pairs_per_strip,
                    const int strips, const int width, const int span) {
    const size_t worker = get_global_id(0);
    __global real *e = field + worker * rows * 8 * width, *w = wave + worker * pairs * 8 * width;
    __global real *f = focal + worker * pairs * 8 * span;
    __global real *p = phasor + worker * blocks * 8 * VEC, *l = sample_field + worker * blocks * 8 * VEC;
    const int columns = 2 * (width / VEC);
    for (int image = atomic_inc(next + tile); image < images; image = atomic_inc(next + tile)) {
        const int s = slot[first + image];
        __global const real *image_pose = pose + (size_t)(first + image) * segments * 4;
        __global real *t = psi + (size_t)image * blocks * 4 * VEC;
        __global const real *d = data + (size_t)s * pairs * 4 * span;
        __global const real *v = weight + (size_t)s * pairs * 4 * span;
        __global real *sum = sums + (size_t)image * strips * 3, *image_photometry = photometry + 2 * image;

        for (int block = 0; block < blocks; block++)
            field_block(t, place, entry_start, entry_segment, entry_weight, entry_x, entry_y, image_pose, p, l, e, block,
                        blocks, width, poses, 0);
        for (int column = 0; column < columns; column++)
            forward_column(e, y_to_v, extent, w, column, 0, 1, rows, pairs, (pairs + TALL - 1) / TALL, width);
        for (int strip = 0; strip < strips; strip++) {
            const int pair = strip * pairs_per_strip, end = min(pairs, pair + pairs_per_strip);
            for (int chunk = 0; chunk < row_chunks(span); chunk++)
                forward_row_chunk(w, x_to_u, f, chunk, pair, end, rows, width, span);
            if (kind[s] != 0) strip_sums(f, d, v, 2 * pair, 2 * end, 0, 1, span, sum + 3 * strip);
        }
        solve(sum, strips, kind[s], known + 4 * s, image_photometry);
        for (int strip = 0; strip < strips; strip++) {
            const int pair = strip * pairs_per_strip, end = min(pairs, pair + pairs_per_strip);
            objective[image * strips + strip] = strip_residuals(f, d, v, 2 * pair, 2 * end, 0, 1, span, image_photometry);
            for (int chunk = 0; chunk < row_chunks(width); chunk++)
                adjoint_row_chunk(f, u_to_x, w, chunk, pair, end, pairs, span, width);
        }
        for (int column = 0; column < columns; column++)
            adjoint_column(w, v_to_y, extent, e, column, 0, 1, pairs, (rows + TALL - 1) / TALL, width);
        for (int block = 0; block < blocks; block++) gradient_block(e, l, p, place, t, block, blocks, width, 0);
        for (int segment = 0; segment < segments; segment++)
            segment_product(p, segment_entry, entry_place, entry_weight, entry_x, entry_y, image_pose + 4 * segment,
                            segment_sum + ((size_t)image * segments + segment) * poses, segment_start[segment],
                            segment_start[segment + 1], COMPLEX_APART(blocks), poses);
    }
}
