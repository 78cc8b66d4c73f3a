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
 * 8 WIDE multiply-adds. Tables are packed in the order of reading; the slice of a work-item fits the first cache.
 *
 *   column table  [group of TALL outputs][input][cos, sin][TALL]
 *   row table     [vector of outputs][...]: chunks of WIDE vectors as [input][cos, sin][WIDE][VEC]; WIDE is 2, and 3 for
 *                 the last chunk of an odd number (1 where there is but one)
 *
 * extent[x / VEC] is the number of rows, counted from the axis, beyond which the pupil is dark in that vector of x.
 */

/* C and S of one vector of x for the TALL outputs of a group. */
inline void column_product(__global const real *in, const int stride, const int width, __global const real *table,
                           const int inputs, vec sum[TALL][4]) {
#pragma unroll
    for (int r = 0; r < TALL; r++)
        sum[r][0] = sum[r][1] = sum[r][2] = sum[r][3] = SPLAT(REAL(0.0));
    for (int k = 0; k < inputs; k++, in += stride, table += 2 * TALL) {
        vec even_re = GET(in, 0), even_im = GET(in, width), odd_re = GET(in, 2 * width), odd_im = GET(in, 3 * width);
#pragma unroll
        for (int r = 0; r < TALL; r++) {
            vec c = SPLAT(table[r]), s = SPLAT(table[TALL + r]);
            sum[r][0] = MAD(c, even_re, sum[r][0]);
            sum[r][1] = MAD(c, even_im, sum[r][1]);
            sum[r][2] = MAD(s, odd_re, sum[r][2]);
            sum[r][3] = MAD(s, odd_im, sum[r][3]);
        }
    }
}

/* field -> wave: global (2 width / VEC, any, images). wave row: [+v, -v][even-x re, im, odd-x re, im][x]. */
__kernel void forward_columns(__global const real *field, __global const real *table, __global const int *extent,
                              __global real *wave, const int rows, const int pairs, const int groups,
                              const int width) {
    const int vectors = width / VEC;
    if ((int)get_global_id(0) >= 2 * vectors) return;
    const int parity = get_global_id(0) / vectors, x = (get_global_id(0) % vectors) * VEC, image = get_global_id(2);
    const int inputs = extent[x / VEC];
    __global const real *in = field + ((size_t)image * rows * 8 + parity * 4) * width + x;
    __global real *out = wave + ((size_t)image * pairs * 8 + parity * 2) * width + x;
    for (int group = get_global_id(1); group < groups; group += get_global_size(1)) {
        vec sum[TALL][4];
        column_product(in, 8 * width, width, table + (size_t)group * rows * (2 * TALL), inputs, sum);
#pragma unroll
        for (int r = 0; r < TALL; r++) {
            const int v = group * TALL + r;
            if (v < pairs) {
                __global real *row = out + (size_t)v * 8 * width;
                AT(row, 0 * width) = sum[r][0] + sum[r][3];
                AT(row, 1 * width) = sum[r][1] - sum[r][2];
                AT(row, 4 * width) = sum[r][0] - sum[r][3];
                AT(row, 5 * width) = sum[r][1] + sum[r][2];
            }
        }
    }
}

/* wave -> field: the adjoint. wave row here: [x parity][C re, C im, S re, S im][x]. */
__kernel void adjoint_columns(__global const real *wave, __global const real *table, __global const int *extent,
                              __global real *field, const int rows, const int pairs, const int groups,
                              const int width) {
    const int vectors = width / VEC;
    if ((int)get_global_id(0) >= 2 * vectors) return;
    const int parity = get_global_id(0) / vectors, x = (get_global_id(0) % vectors) * VEC, image = get_global_id(2);
    const int outputs = extent[x / VEC];
    __global const real *in = wave + ((size_t)image * pairs * 8 + parity * 4) * width + x;
    __global real *out = field + ((size_t)image * rows * 8 + parity * 4) * width + x;
    for (int group = get_global_id(1); group < groups && group * TALL < outputs; group += get_global_size(1)) {
        vec sum[TALL][4];
        column_product(in, 8 * width, width, table + (size_t)group * pairs * (2 * TALL), pairs, sum);
#pragma unroll
        for (int r = 0; r < TALL; r++) {
            const int y = group * TALL + r;
            if (y < outputs) {
                __global real *row = out + (size_t)y * 8 * width;
                AT(row, 0 * width) = sum[r][0];
                AT(row, 1 * width) = sum[r][1];
                AT(row, 2 * width) = sum[r][2];
                AT(row, 3 * width) = sum[r][3];
            }
        }
    }
}

/* The four sums of WIDE output vectors for the two rows of a pair, which lie 4 `in_width` apart. */
#define ROW_PRODUCT(WIDE)                                                                                              \
    vec sum[2][WIDE][4];                                                                                               \
    _Pragma("unroll") for (int row = 0; row < 2; row++)                                                                \
        _Pragma("unroll") for (int b = 0; b < WIDE; b++)                                                               \
            sum[row][b][0] = sum[row][b][1] = sum[row][b][2] = sum[row][b][3] = SPLAT(REAL(0.0));                      \
    __global const real *t = table + (size_t)start * inputs * (2 * VEC);                                               \
    for (int k = 0; k < inputs; k++, t += 2 * WIDE * VEC) {                                                            \
        vec c[WIDE], s[WIDE];                                                                                          \
        _Pragma("unroll") for (int b = 0; b < WIDE; b++) {                                                             \
            c[b] = GET(t, b * VEC);                                                                                    \
            s[b] = GET(t, (WIDE + b) * VEC);                                                                           \
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
        _Pragma("unroll") for (int row = 0; row < 2; row++)                                                            \
            _Pragma("unroll") for (int b = 0; b < WIDE; b++)                                                           \
                _Pragma("unroll") for (int plane = 0; plane < 4; plane++)                                              \
                    AT(out, (row * 4 + plane) * span + (start + b) * VEC) = sum[row][b][plane];                        \
    }

/* wave -> focal, planes C re, C im, S re, S im of each row: global (chunks, any, images). */
__kernel void forward_rows(__global const real *wave, __global const real *table, __global real *focal,
                           const int inputs, const int pairs, const int pairs_per_item, const int in_width,
                           const int span) {
    const int vectors = span / VEC, chunks = max(1, vectors / 2);
    const int chunk = get_global_id(0), image = get_global_id(2);
    if (chunk >= chunks) return;
    const int start = 2 * chunk, count = chunk + 1 < chunks ? 2 : vectors - start;
    const int end = min(pairs, (int)(get_global_id(1) + 1) * pairs_per_item);
    for (int pair = get_global_id(1) * pairs_per_item; pair < end; pair++) {
        __global const real *in = wave + (size_t)(image * pairs + pair) * 8 * in_width;
        __global real *out = focal + (size_t)(image * pairs + pair) * 8 * span;
        if (count == 2) FORWARD_ROWS(2)
        else if (count == 3) FORWARD_ROWS(3)
        else FORWARD_ROWS(1)
    }
}

#define ADJOINT_ROWS(WIDE)                                                                                             \
    {                                                                                                                  \
        ROW_PRODUCT(WIDE)                                                                                              \
        _Pragma("unroll") for (int b = 0; b < WIDE; b++)                                                               \
            _Pragma("unroll") for (int parity = 0; parity < 2; parity++) {                                             \
                const int x = parity * 4 * width + (start + b) * VEC;                                                  \
                vec plus_re = sum[0][b][2 * parity], plus_im = sum[0][b][2 * parity + 1];                              \
                vec minus_re = sum[1][b][2 * parity], minus_im = sum[1][b][2 * parity + 1];                            \
                AT(out, x) = plus_re + minus_re;                                                                       \
                AT(out, x + width) = plus_im + minus_im;                                                               \
                AT(out, x + 2 * width) = minus_im - plus_im;                                                           \
                AT(out, x + 3 * width) = plus_re - minus_re;                                                           \
            }                                                                                                          \
    }

/* focal (holding C' and S' of each row) -> wave, as adjoint_columns reads it: global (chunks, any, images). */
__kernel void adjoint_rows(__global const real *focal, __global const real *table, __global real *wave,
                           const int inputs, const int pairs, const int pairs_per_item, const int in_width,
                           const int width) {
    const int vectors = width / VEC, chunks = max(1, vectors / 2);
    const int chunk = get_global_id(0), image = get_global_id(2);
    if (chunk >= chunks) return;
    const int start = 2 * chunk, count = chunk + 1 < chunks ? 2 : vectors - start;
    const int end = min(pairs, (int)(get_global_id(1) + 1) * pairs_per_item);
    for (int pair = get_global_id(1) * pairs_per_item; pair < end; pair++) {
        __global const real *in = focal + (size_t)(image * pairs + pair) * 8 * in_width;
        __global real *out = wave + (size_t)(image * pairs + pair) * 8 * width;
        if (count == 2) ADJOINT_ROWS(2)
        else if (count == 3) ADJOINT_ROWS(3)
        else ADJOINT_ROWS(1)
    }
}
