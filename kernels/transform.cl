/*
 * transform.cl: pupil <-> focus as two real matrix products, folded about the axis, and the adjoint of each.
 *
 *   U(v, u) = sum_{y, x} E(y, x) exp(-2 pi i step (x u + y v)),   x, y half-integers, u, v = -m/2 ... m/2
 *
 * Down the columns (y to v) and then along the rows (x to u), each as C = sum cos * even, S = sum sin * odd,
 * T(+-v) = C -+ i S. The adjoints run the same products the other way with transposed tables: rows first, where
 * C' = G(+) + G(-), S' = i (G(+) - G(-)).
 *
 * Columns: a vector of x for TALL output rows; per step 4 vectors and 2 TALL broadcasts for 4 TALL multiply-adds.
 * Rows: the two rows of a pair times WIDE vectors of outputs; per step 2 WIDE vectors of the table and 8 broadcasts for
 * 8 WIDE multiply-adds. Tables are packed in the order of reading; the slice of a work-item fits the first-level cache.
 *
 *   column table  [group of TALL outputs][input][cos, sin][TALL]
 *   row table     chunks of vectors of outputs as [input][cos, sin][WIDE][VEC]; WIDE is 2, and 3 for the last chunk of an odd
 *                 number of vectors (1 where there is only one vector). On a GPU [input][cos, sin][output]: a work-item computes
 *                 WIDE outputs `chunks` apart, so that neighbouring work-items read neighbouring numbers
 *
 * extent[x / VEC] is the number of rows, counted from the axis, beyond which that vector of x has no illuminated sample.
 *
 * A row pair of the wave is [+v, -v][even-x re, im, odd-x re, im][x] in the forward transform and
 * [x parity][C' re, C' im, S' re, S' im][x] in the adjoint. The functions before the kernels process the arrays of one image;
 * focus.cl calls them too.
 */

/* C and S of one vector of x for the TALL outputs of a group. */
inline void column_product(__global const real *in, const int stride, const int width, __global const real *table,
                           const int inputs, vec sum[TALL][4]) {
#pragma unroll
    for (int r = 0; r < TALL; r++)
        sum[r][0] = sum[r][1] = sum[r][2] = sum[r][3] = SPLAT(REAL(0.0));
    for (int k = 0; k < inputs; k++, in += stride, table += 2 * TALL) {
        vec even_re = GET(in, 0), even_im = GET(in, width), odd_re = GET(in, 2 * width), odd_im = GET(in, 3 * width);
        real factor[2 * TALL];
#if VEC == 1
        /* A quarter of the loads. A group begins at a multiple of 2 TALL numbers, which 4 divides. */
#pragma unroll
        for (int i = 0; i < 2 * TALL; i += 4) {
            const JOIN(BASE, 4) four = *(__global const JOIN(BASE, 4) *)(table + i);
            factor[i] = four.x, factor[i + 1] = four.y, factor[i + 2] = four.z, factor[i + 3] = four.w;
        }
#else
#pragma unroll
        for (int i = 0; i < 2 * TALL; i++) factor[i] = table[i];
#endif
#pragma unroll
        for (int r = 0; r < TALL; r++) {
            vec c = SPLAT(factor[r]), s = SPLAT(factor[TALL + r]);
            sum[r][0] = MAD(c, even_re, sum[r][0]);
            sum[r][1] = MAD(c, even_im, sum[r][1]);
            sum[r][2] = MAD(s, odd_re, sum[r][2]);
            sum[r][3] = MAD(s, odd_im, sum[r][3]);
        }
    }
}

/* Columns `column` (x parity, then vector of x) of one image, output groups `group`, `group + step`, ... */
inline void forward_column(__global const real *field, __global const real *table, __global const int *extent,
                           __global real *wave, const int column, int group, const int step, const int rows,
                           const int pairs, const int groups, const int width) {
    const int parity = column / (width / VEC), x = column % (width / VEC) * VEC;
    const int inputs = extent[x / VEC];
    __global const real *in = field + parity * 4 * width + x;
    for (; group < groups; group += step) {
        vec sum[TALL][4];
        column_product(in, 8 * width, width, table + (size_t)group * rows * (2 * TALL), inputs, sum);
#pragma unroll
        for (int r = 0; r < TALL; r++) {
            const int v = group * TALL + r;
            if (v < pairs) {
                __global real *row = wave + ((size_t)v * 8 + parity * 2) * width + x;
                AT(row, 0 * width) = sum[r][0] + sum[r][3];
                AT(row, 1 * width) = sum[r][1] - sum[r][2];
                AT(row, 4 * width) = sum[r][0] - sum[r][3];
                AT(row, 5 * width) = sum[r][1] + sum[r][2];
            }
        }
    }
}

/* Adjoint of forward_column. Rows beyond the extent of this vector of x are not written. */
inline void adjoint_column(__global const real *wave, __global const real *table, __global const int *extent,
                           __global real *field, const int column, int group, const int step, const int pairs,
                           const int groups, const int width) {
    const int parity = column / (width / VEC), x = column % (width / VEC) * VEC;
    const int outputs = extent[x / VEC];
    __global const real *in = wave + parity * 4 * width + x;
    for (; group < groups && group * TALL < outputs; group += step) {
        vec sum[TALL][4];
        column_product(in, 8 * width, width, table + (size_t)group * pairs * (2 * TALL), pairs, sum);
#pragma unroll
        for (int r = 0; r < TALL; r++) {
            const int y = group * TALL + r;
            if (y < outputs) {
                __global real *row = field + ((size_t)y * 8 + parity * 4) * width + x;
                AT(row, 0 * width) = sum[r][0];
                AT(row, 1 * width) = sum[r][1];
                AT(row, 2 * width) = sum[r][2];
                AT(row, 3 * width) = sum[r][3];
            }
        }
    }
}

/* Number of chunks of outputs in a row of `width` numbers. Output vector b of a chunk: its place in the row, whether it is there, and
   its cosine and sine at `t`, the part of the table for one input. */
#if VEC == 1
#define ROW_WIDE 4
inline int row_chunks(const int width) { return (width + ROW_WIDE - 1) / ROW_WIDE; }
#define ROW_PLACE(b) (chunk + (b) * chunks)
#define ROW_IS_THERE(b) (ROW_PLACE(b) < outputs)
#define ROW_TABLE table
#define ROW_STEP(WIDE) (2 * outputs)
#define ROW_COS(b, WIDE) t[min(ROW_PLACE(b), outputs - 1)]
#define ROW_SIN(b, WIDE) t[outputs + min(ROW_PLACE(b), outputs - 1)]
#define ROW_CHUNK(DO) DO(ROW_WIDE)
#else
inline int row_chunks(const int width) { return max(1, width / VEC / 2); }
#define ROW_PLACE(b) ((2 * chunk + (b)) * VEC)
#define ROW_IS_THERE(b) true
#define ROW_TABLE (table + (size_t)chunk * inputs * (4 * VEC))
#define ROW_STEP(WIDE) (2 * WIDE * VEC)
#define ROW_COS(b, WIDE) GET(t, (b) * VEC)
#define ROW_SIN(b, WIDE) GET(t, (WIDE + (b)) * VEC)
/* The last chunk takes what is left. */
#define ROW_CHUNK(DO)                                                                                                  \
    {                                                                                                                  \
        const int count = chunk + 1 < chunks ? 2 : outputs / VEC - 2 * chunk;                                          \
        if (count == 2) DO(2)                                                                                          \
        else if (count == 3) DO(3)                                                                                     \
        else DO(1)                                                                                                     \
    }
#endif

/* The four sums of WIDE output vectors for the two rows of a pair, which lie 4 `in_width` apart. */
#define ROW_PRODUCT(WIDE)                                                                                              \
    vec sum[2][WIDE][4];                                                                                               \
    _Pragma("unroll") for (int row = 0; row < 2; row++)                                                                \
        _Pragma("unroll") for (int b = 0; b < WIDE; b++)                                                               \
            sum[row][b][0] = sum[row][b][1] = sum[row][b][2] = sum[row][b][3] = SPLAT(REAL(0.0));                      \
    __global const real *t = ROW_TABLE;                                                                                \
    for (int k = 0; k < inputs; k++, t += ROW_STEP(WIDE)) {                                                            \
        vec c[WIDE], s[WIDE];                                                                                          \
        _Pragma("unroll") for (int b = 0; b < WIDE; b++) {                                                             \
            c[b] = ROW_COS(b, WIDE);                                                                                   \
            s[b] = ROW_SIN(b, WIDE);                                                                                   \
        }                                                                                                              \
        _Pragma("unroll") for (int row = 0; row < 2; row++) {                                                          \
            __global const real *a = in + row * 4 * in_width + k;                                                      \
            vec even_re = SPLAT(a[0]), even_im = SPLAT(a[in_width]);                                                   \
            vec odd_re = SPLAT(a[2 * in_width]), odd_im = SPLAT(a[3 * in_width]);                                      \
            _Pragma("unroll") for (int b = 0; b < WIDE; b++) {                                                         \
                sum[row][b][0] = MAD(c[b], even_re, sum[row][b][0]);                                                   \
                sum[row][b][1] = MAD(c[b], even_im, sum[row][b][1]);                                                   \
                sum[row][b][2] = MAD(s[b], odd_re, sum[row][b][2]);                                                    \
                sum[row][b][3] = MAD(s[b], odd_im, sum[row][b][3]);                                                    \
            }                                                                                                          \
        }                                                                                                              \
    }

#define FORWARD_ROWS(WIDE)                                                                                             \
    {                                                                                                                  \
        ROW_PRODUCT(WIDE)                                                                                              \
        _Pragma("unroll") for (int b = 0; b < WIDE; b++) if (ROW_IS_THERE(b))                                          \
            _Pragma("unroll") for (int row = 0; row < 2; row++)                                                        \
                _Pragma("unroll") for (int plane = 0; plane < 4; plane++)                                              \
                    AT(out, (row * 4 + plane) * outputs + ROW_PLACE(b)) = sum[row][b][plane];                          \
    }

/* The outputs of one chunk for the row pairs `pair` to `end` of one image. */
inline void forward_row_chunk(__global const real *wave, __global const real *table, __global real *focal,
                              const int chunk, int pair, const int end, const int inputs, const int in_width,
                              const int outputs) {
    const int chunks = row_chunks(outputs);
    for (; pair < end; pair++) {
        __global const real *in = wave + (size_t)pair * 8 * in_width;
        __global real *out = focal + (size_t)pair * 8 * outputs;
        ROW_CHUNK(FORWARD_ROWS)
    }
}

#define ADJOINT_ROWS(WIDE)                                                                                             \
    {                                                                                                                  \
        ROW_PRODUCT(WIDE)                                                                                              \
        _Pragma("unroll") for (int b = 0; b < WIDE; b++) if (ROW_IS_THERE(b))                                          \
            _Pragma("unroll") for (int parity = 0; parity < 2; parity++) {                                             \
                const int x = parity * 4 * outputs + ROW_PLACE(b);                                                     \
                vec plus_re = sum[0][b][2 * parity], plus_im = sum[0][b][2 * parity + 1];                              \
                vec minus_re = sum[1][b][2 * parity], minus_im = sum[1][b][2 * parity + 1];                            \
                AT(out, x) = plus_re + minus_re;                                                                       \
                AT(out, x + outputs) = plus_im + minus_im;                                                             \
                AT(out, x + 2 * outputs) = minus_im - plus_im;                                                         \
                AT(out, x + 3 * outputs) = plus_re - minus_re;                                                         \
            }                                                                                                          \
    }

/* Adjoint of forward_row_chunk: focal holds C' and S' of each row. */
inline void adjoint_row_chunk(__global const real *focal, __global const real *table, __global real *wave,
                              const int chunk, int pair, const int end, const int inputs, const int in_width,
                              const int outputs) {
    const int chunks = row_chunks(outputs);
    for (; pair < end; pair++) {
        __global const real *in = focal + (size_t)pair * 8 * in_width;
        __global real *out = wave + (size_t)pair * 8 * outputs;
        ROW_CHUNK(ADJOINT_ROWS)
    }
}

/* field -> wave: global (2 width / VEC, any, images). */
__kernel void forward_columns(__global const real *field, __global const real *table, __global const int *extent,
                              __global real *wave, const int rows, const int pairs, const int groups,
                              const int width) {
    if ((int)get_global_id(0) >= 2 * (width / VEC)) return;
    const size_t image = get_global_id(2);
    forward_column(field + image * rows * 8 * width, table, extent, wave + image * pairs * 8 * width,
                   get_global_id(0), get_global_id(1), get_global_size(1), rows, pairs, groups, width);
}

/* wave -> focal: global (chunks times any, 1, images). */
__kernel void forward_rows(__global const real *wave, __global const real *table, __global real *focal,
                           const int inputs, const int pairs, const int pairs_per_item, const int in_width,
                           const int span) {
    const int chunks = row_chunks(span), pair = get_global_id(0) / chunks * pairs_per_item;
    const size_t image = get_global_id(2);
    forward_row_chunk(wave + image * pairs * 8 * in_width, table, focal + image * pairs * 8 * span,
                      get_global_id(0) % chunks, pair, min(pairs, pair + pairs_per_item), inputs, in_width, span);
}

/* focal -> wave: global (chunks times any, 1, images). */
__kernel void adjoint_rows(__global const real *focal, __global const real *table, __global real *wave,
                           const int inputs, const int pairs, const int pairs_per_item, const int in_width,
                           const int width) {
    const int chunks = row_chunks(width), pair = get_global_id(0) / chunks * pairs_per_item;
    const size_t image = get_global_id(2);
    adjoint_row_chunk(focal + image * pairs * 8 * in_width, table, wave + image * pairs * 8 * width,
                      get_global_id(0) % chunks, pair, min(pairs, pair + pairs_per_item), inputs, in_width, width);
}

/* wave -> field: global (2 width / VEC, any, images). */
__kernel void adjoint_columns(__global const real *wave, __global const real *table, __global const int *extent,
                              __global real *field, const int rows, const int pairs, const int groups,
                              const int width) {
    if ((int)get_global_id(0) >= 2 * (width / VEC)) return;
    const size_t image = get_global_id(2);
    adjoint_column(wave + image * pairs * 8 * width, table, extent, field + image * rows * 8 * width, get_global_id(0),
                   get_global_id(1), get_global_size(1), pairs, groups, width);
}
