/*
 * common.cl: number types, vectors and layouts that every kernel shares. Prepended to each file of this folder.
 *
 * Preprocessor definitions (set by src/device/table.rs):
 *   DOUBLE  0 | 1          real is float or double
 *   VEC     1 | 4 | 8 | 16 numbers in one `vec`. On a CPU: the width of its registers (explicit vectors reach its peak
 *                          rate, PoCL's vectorisation across work-items does not). On a GPU: 1, so that neighbouring
 *                          work-items read neighbouring numbers.
 *   GROUP   4              images per work-item in the products with the modes (see field.cl)
 *   TALL    6              output rows per work-item in the products along columns (see transform.cl)
 *
 * The folded layout. Pupil and image are symmetric about the optical axis, so that a Fourier sum over +-x splits into
 * a cosine sum over E(+x) + E(-x) and a sine sum over E(+x) - E(-x), each real and half as long: a quarter of the work of
 * a complex product. Arrays are stored by distance from the axis and by quadrant; only the host uses x and y.
 *
 * Samples and pixels lie i + 1/2 steps from the axis, so that no pixel lies on it: the host adds a tilt to the diversity that
 * moves the image by half a pixel, and the intensities are exactly those of the unshifted pixels.
 *
 *   pupil quadrants  q = 0: (+y +x), 1: (+y -x), 2: (-y +x), 3: (-y -x)
 *   pupil block      VEC samples next to each other in x, in all four quadrants; each column of blocks ends with the
 *                    last block that has an illuminated sample
 *   field     [image][y][x parity][even-y re, even-y im, odd-y re, odd-y im][x]      x padded to `width`
 *   wave      [image][pair][...two rows of four planes...][x]                        a row pair is rows v and -v
 *   focal     [image][pair][+v, -v][four planes][u]                                  padded to `span`
 *   pixels    [slot][pair][+v, -v][+u, -u][u]; weight 0 where a pixel is bad or padding
 *
 * Every padded extent is a multiple of VEC, so that vectors are aligned.
 */
#if DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double real;
#define REAL(x) x
#else
typedef float real;
#define REAL(x) x##f
#endif

/* Type of the sums for photometry and objective: double where the device supports it. */
#if DOUBLE || defined(cl_khr_fp64)
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double wide;
#else
typedef float wide;
#endif

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)

#if DOUBLE
#define BASE double
#else
#define BASE float
#endif

#if VEC == 1
typedef real vec;
#else
typedef JOIN(BASE, VEC) vec;
#endif

#ifndef GROUP
#define GROUP 4
#endif
#ifndef TALL
#define TALL 6
#endif

/* The vector at number `i` of a real array; `i` is a multiple of VEC. */
#define AT(array, i) (*(__global vec *)((array) + (i)))
#define GET(array, i) (*(__global const vec *)((array) + (i)))

/* Fused multiply-add in hardware (one rounding); otherwise a product and a sum (two roundings), never an emulated fma. */
#if (DOUBLE && defined(FP_FAST_FMA)) || (!DOUBLE && defined(FP_FAST_FMAF))
#define MAD(a, b, c) fma(a, b, c)
#else
#define MAD(a, b, c) mad(a, b, c)
#endif
#define SPLAT(s) ((vec)(s))

/* Index of a number of a block, in vectors; index of the real part of a complex number, and its distance to the imaginary
   part. On a GPU neighbouring work-items process neighbouring blocks; on a CPU a work-item processes a whole block. */
#if VEC == 1
#define PLANE(q, block, blocks) ((q) * (blocks) + (block))
#define COMPLEX(q, block, blocks) (2 * (q) * (blocks) + (block))
#define COMPLEX_APART(blocks) (blocks)
#else
#define PLANE(q, block, blocks) (4 * (block) + (q))
#define COMPLEX(q, block, blocks) (8 * (block) + 2 * (q))
#define COMPLEX_APART(blocks) 1
#endif

inline real sum_lanes(vec v) {
#if VEC == 1
    return v;
#else
#if VEC == 16
    JOIN(BASE, 8) a = v.lo + v.hi;
    JOIN(BASE, 4) b = a.lo + a.hi;
#elif VEC == 8
    JOIN(BASE, 4) b = v.lo + v.hi;
#else
    JOIN(BASE, 4) b = v;
#endif
    JOIN(BASE, 2) c = b.lo + b.hi;
    return c.x + c.y;
#endif
}
