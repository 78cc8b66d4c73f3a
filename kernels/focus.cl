/*
 * focus.cl: from the phase of an image to its objective and to the gradient by the phase, in one kernel: pupil_field to
 * project_segments with the same arithmetic in the same order. For a CPU with at least one image per core. `focus` is for images
 * that are the squared modulus of one field, `focus_stored` for several wavelengths and for pixels with an area.
 *
 * A work-item processes whole images, one after the other, in arrays of its own (field, phasor, sample_field, wave, focal,
 * intensity, convolved), which stay in the second-level cache of its core; only psi, data and weights are read from memory, and
 * only D is written. The rows of a strip are transformed and summed, and later subtracted and transformed back, while they are in
 * the first-level cache.
 *
 * global (workers, 1, 1), local (1, 1, 1). A worker takes the next unprocessed image by incrementing the counter next[tile],
 * which is 0 before the launch: OpenCL does not define how work-items are distributed over cores (PoCL assigns too many to the
 * first core), and a core may be busy with another program. There are two or more workers per core, so that each core has one;
 * late workers find no image and return. The results do not depend on which worker processes an image.
 * The adjoint overwrites `field`.
 */

/* From the phase of an image to its wave at one wavelength; `scale`, `excess` and `pose` as in field_block. */
inline void phase_to_wave(__global const real *psi, __global const real *excess, const real scale,
                          __global const int *place, __global const int *entry_start,
                          __global const int *entry_segment, __global const real *entry_weight,
                          __global const real *entry_x, __global const real *entry_y, __global const real *pose,
                          __global real *phasor, __global real *sample_field, __global real *field,
                          __global const real *y_to_v, __global const int *extent, __global real *wave, const int blocks,
                          const int poses, const int rows, const int pairs, const int width) {
    for (int block = 0; block < blocks; block++)
        field_block(psi, excess, scale, place, entry_start, entry_segment, entry_weight, entry_x, entry_y, pose, phasor,
                    sample_field, field, block, blocks, width, poses, 0);
    for (int column = 0; column < 2 * (width / VEC); column++)
        forward_column(field, y_to_v, extent, wave, column, 0, 1, rows, pairs, (pairs + TALL - 1) / TALL, width);
}

/* From the adjoint wave of one wavelength to the gradient by the phase and by the poses of the segments; `is_first` as in
   gradient_block. */
inline void wave_to_gradient(__global const real *wave, __global const real *v_to_y, __global const int *extent,
                             __global real *field, __global const real *sample_field, __global real *phasor,
                             __global const int *place, __global real *psi, __global const int *segment_start,
                             __global const int *segment_entry, __global const int *entry_place,
                             __global const real *entry_weight, __global const real *entry_x,
                             __global const real *entry_y, __global const real *pose, __global real *segment_sum,
                             const real scale, const int is_first, const int blocks, const int segments,
                             const int poses, const int rows, const int pairs, const int width) {
    for (int column = 0; column < 2 * (width / VEC); column++)
        adjoint_column(wave, v_to_y, extent, field, column, 0, 1, pairs, (rows + TALL - 1) / TALL, width);
    for (int block = 0; block < blocks; block++)
        gradient_block(field, sample_field, phasor, place, psi, scale, is_first, block, blocks, width, 0);
    for (int segment = 0; segment < segments; segment++)
        segment_product(phasor, segment_entry, entry_place, entry_weight, entry_x, entry_y, pose + 4 * segment,
                        segment_sum + segment * poses, scale, is_first, segment_start[segment],
                        segment_start[segment + 1], COMPLEX_APART(blocks), poses);
}

/* The rows of a strip, wave to focal field and back. */
inline void forward_strip(__global const real *wave, __global const real *x_to_u, __global real *focal, const int pair,
                          const int end, const int rows, const int width, const int span) {
    for (int chunk = 0; chunk < row_chunks(span); chunk++)
        forward_row_chunk(wave, x_to_u, focal, chunk, pair, end, rows, width, span);
}
inline void adjoint_strip(__global const real *focal, __global const real *u_to_x, __global real *wave, const int pair,
                          const int end, const int pairs, const int span, const int width) {
    for (int chunk = 0; chunk < row_chunks(width); chunk++)
        adjoint_row_chunk(focal, u_to_x, wave, chunk, pair, end, pairs, span, width);
}

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
    for (int image = atomic_inc(next + tile); image < images; image = atomic_inc(next + tile)) {
        const int s = slot[first + image];
        __global const real *image_pose = pose + (size_t)(first + image) * segments * 4;
        __global real *t = psi + (size_t)image * blocks * 4 * VEC;
        __global const real *d = data + (size_t)s * pairs * 4 * span;
        __global const real *v = weight + (size_t)s * pairs * 4 * span;
        __global real *sum = sums + (size_t)image * strips * 3, *image_photometry = photometry + 2 * image;

        phase_to_wave(t, 0, REAL(1.0), place, entry_start, entry_segment, entry_weight, entry_x, entry_y, image_pose, p, l,
                      e, y_to_v, extent, w, blocks, poses, rows, pairs, width);
        for (int strip = 0; strip < strips; strip++) {
            const int pair = strip * pairs_per_strip, end = min(pairs, pair + pairs_per_strip);
            forward_strip(w, x_to_u, f, pair, end, rows, width, span);
            if (kind[s] != 0) strip_sums(f, d, v, 2 * pair, 2 * end, 0, 1, span, sum + 3 * strip);
        }
        add_and_solve(sum, strips, kind[s], known + 4 * s, image_photometry);
        for (int strip = 0; strip < strips; strip++) {
            const int pair = strip * pairs_per_strip, end = min(pairs, pair + pairs_per_strip);
            objective[image * strips + strip] = strip_residuals(f, d, v, 2 * pair, 2 * end, 0, 1, span, image_photometry);
            adjoint_strip(f, u_to_x, w, pair, end, pairs, span, width);
        }
        wave_to_gradient(w, v_to_y, extent, e, l, p, place, t, segment_start, segment_entry, entry_place, entry_weight,
                         entry_x, entry_y, image_pose, segment_sum + (size_t)image * segments * poses, REAL(1.0), 1, blocks,
                         segments, poses, rows, pairs, width);
    }
}

/* From the intensity of an image to photometry, objective and the source of the adjoint in its place; `terms` as in focus_stored. */
inline void intensity_to_source(__global real *intensity, __global real *convolved, __global const real *term,
                                const int terms, __global const real *data, __global const real *weight,
                                const int kind, __global const real *known, __global real *sums,
                                __global real *photometry, __global real *objective, const int pairs,
                                const int pairs_per_strip, const int strips, const int span) {
    if (terms > 0) convolve_image(intensity, convolved, term, terms - 1, pairs, span);
    for (int strip = 0; kind != 0 && strip < strips; strip++) {
        const int pair = strip * pairs_per_strip, end = min(pairs, pair + pairs_per_strip);
        intensity_strip_sums(intensity, data, weight, 2 * pair, 2 * end, 0, 1, span, sums + 3 * strip);
    }
    add_and_solve(sums, strips, kind, known, photometry);
    for (int strip = 0; strip < strips; strip++) {
        const int pair = strip * pairs_per_strip, end = min(pairs, pair + pairs_per_strip);
        objective[strip] =
            intensity_strip_residuals(intensity, data, weight, 2 * pair, 2 * end, 0, 1, span, photometry);
    }
    if (terms > 0) convolve_image(intensity, convolved, term, terms - 1, pairs, span);
}

/* The arrays of wavelength k begin k times `..._apart` numbers after those of the first; scales [wavelength]. `terms` is the number
   of terms of the convolution, 0 for pixels that are points. */
__kernel void focus_stored(__global real *psi, __global const real *excess, __global const real *scales,
                           __global const int *place, __global const int *entry_start,
                           __global const int *entry_segment, __global const real *entry_weight,
                           __global const real *entry_x, __global const real *entry_y,
                           __global const int *segment_start, __global const int *segment_entry,
                           __global const int *entry_place, __global const real *pose, __global real *phasor,
                           __global real *sample_field, __global real *field, __global const real *y_to_v,
                           __global const real *x_to_u, __global const real *u_to_x, __global const real *v_to_y,
                           __global const int *extent, __global real *wave, __global real *focal,
                           __global real *intensity, __global real *convolved, __global const real *term,
                           __global const real *data, __global const real *weight, __global const int *slot,
                           __global const int *kind, __global const real *known, __global real *sums,
                           __global real *objective, __global real *photometry, __global real *segment_sum,
                           volatile __global int *next, const int tile, const int first, const int images,
                           const int colours, const int excess_apart, const int pose_apart, const int phasor_apart,
                           const int y_to_v_apart, const int x_to_u_apart, const int u_to_x_apart,
                           const int v_to_y_apart, const int focal_apart, const int blocks, const int segments,
                           const int poses, const int rows, const int pairs, const int pairs_per_strip,
                           const int strips, const int width, const int span, const int terms) {
    const size_t worker = get_global_id(0);
    __global real *e = field + worker * rows * 8 * width, *w = wave + worker * pairs * 8 * width;
    __global real *h = intensity + worker * pairs * 4 * span, *c = convolved + worker * pairs * 4 * span;
    for (int image = atomic_inc(next + tile); image < images; image = atomic_inc(next + tile)) {
        const int s = slot[first + image];
        __global real *t = psi + (size_t)image * blocks * 4 * VEC;
        __global const real *d = data + (size_t)s * pairs * 4 * span;
        __global const real *v = weight + (size_t)s * pairs * 4 * span;
        __global real *sum = sums + (size_t)image * strips * 3, *image_photometry = photometry + 2 * image;

        for (int k = 0; k < colours; k++) {
            const size_t own = (size_t)k * phasor_apart + worker * blocks * 8 * VEC;
            __global real *f = focal + (size_t)k * focal_apart + worker * pairs * 8 * span;
            phase_to_wave(t, excess + (size_t)k * excess_apart, scales[k], place, entry_start, entry_segment, entry_weight,
                          entry_x, entry_y, pose + (size_t)k * pose_apart + (size_t)(first + image) * segments * 4,
                          phasor + own, sample_field + own, e, y_to_v + (size_t)k * y_to_v_apart, extent, w, blocks, poses,
                          rows, pairs, width);
            for (int pair = 0; pair < pairs; pair += pairs_per_strip) {
                const int end = min(pairs, pair + pairs_per_strip);
                forward_strip(w, x_to_u + (size_t)k * x_to_u_apart, f, pair, end, rows, width, span);
                add_strip_intensity(f, h, 2 * pair, 2 * end, 0, 1, span, k == 0);
            }
        }
        intensity_to_source(h, c, term, terms, d, v, kind[s], known + 4 * s, sum, image_photometry,
                            objective + (size_t)image * strips, pairs, pairs_per_strip, strips, span);
        for (int k = 0; k < colours; k++) {
            const size_t own = (size_t)k * phasor_apart + worker * blocks * 8 * VEC;
            __global real *f = focal + (size_t)k * focal_apart + worker * pairs * 8 * span;
            for (int pair = 0; pair < pairs; pair += pairs_per_strip) {
                const int end = min(pairs, pair + pairs_per_strip);
                scale_strip(f, h, 2 * pair, 2 * end, 0, 1, span);
                adjoint_strip(f, u_to_x + (size_t)k * u_to_x_apart, w, pair, end, pairs, span, width);
            }
            wave_to_gradient(w, v_to_y + (size_t)k * v_to_y_apart, extent, e, sample_field + own, phasor + own, place, t,
                             segment_start, segment_entry, entry_place, entry_weight, entry_x, entry_y,
                             pose + (size_t)k * pose_apart + (size_t)(first + image) * segments * 4,
                             segment_sum + (size_t)image * segments * poses, scales[k], k == 0, blocks, segments, poses,
                             rows, pairs, width);
        }
    }
}
