/*
 * peak.cl: peak rates of a device: independent multiply-adds, and reads from memory.
 *
 * peak_flops: PEAK_CHAINS independent sums in registers, enough to cover the latency of a multiply-add on two pipes;
 * `scale` and `offset` are arguments so that the compiler cannot evaluate the result. out [work-item].
 * peak_read: each work-item sums its share of `numbers`: `share` consecutive vectors on a CPU, every
 * get_global_size(0)-th number on a GPU. out [work-item].
 */
#define PEAK_CHAINS 16

__kernel void peak_flops(__global real *out, const int count, const real scale, const real offset) {
    const vec a = SPLAT(scale), b = SPLAT(offset);
    vec x[PEAK_CHAINS];
#pragma unroll
    for (int i = 0; i < PEAK_CHAINS; i++) x[i] = SPLAT((real)(get_global_id(0) + i));
    for (int k = 0; k < count; k++) {
#pragma unroll
        for (int i = 0; i < PEAK_CHAINS; i++) x[i] = MAD(x[i], a, b);
    }
    vec sum = x[0];
#pragma unroll
    for (int i = 1; i < PEAK_CHAINS; i++) sum += x[i];
    out[get_global_id(0)] = sum_lanes(sum);
}

__kernel void peak_read(__global const real *numbers, __global real *out, const int share) {
    const size_t item = get_global_id(0);
#if VEC == 1
    const size_t step = get_global_size(0), start = item;
#else
    const size_t step = VEC, start = item * share * VEC;
#endif
    vec sum[4];
    for (int i = 0; i < 4; i++) sum[i] = SPLAT(REAL(0.0));
    for (size_t k = 0; k < share; k += 4) {
#pragma unroll
        for (int i = 0; i < 4; i++) sum[i] += GET(numbers, start + (k + i) * step);
    }
    out[item] = sum_lanes((sum[0] + sum[1]) + (sum[2] + sum[3]));
}
