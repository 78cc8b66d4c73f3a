//! Arrays of the caller's, wherever their elements lie.

use super::pointer::place;
use crate::{Error, Result};

/// A stack of `count` maps or images of `rows` × `cols` float elements (row = y, col = x) in memory of the caller's.
///
/// Element (k, y, x) is at `data + k*count_stride + y*row_stride + x*col_stride`. Strides count elements, not bytes, and
/// may be negative; that of an extent of 1 does not matter. So C order has row_stride = cols and col_stride = 1, MATLAB's
/// column order row_stride = 1 and col_stride = rows, and a map can be turned over or put into a larger one without a
/// copy. The elements of an output must not overlap. The layout of this struct is permanent.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct cophase_array_f32 {
    /// Element (0, 0, 0).
    pub data: *mut f32,
    /// Maps or images.
    pub count: usize,
    /// Rows of each.
    pub rows: usize,
    /// Columns of each.
    pub cols: usize,
    /// Elements from one map to the next.
    pub count_stride: isize,
    /// Elements from one row to the next.
    pub row_stride: isize,
    /// Elements from one column to the next.
    pub col_stride: isize,
}

/// An array that may be written to.
#[derive(Debug)]
pub(super) struct Output {
    data: *mut f32,
    extents: [usize; 3],
    strides: [isize; 3],
}

impl Output {
    /// The array that the argument `name` describes, which must have the `wanted` [count, rows, cols]. The caller's
    /// promise: memory at every element.
    pub(super) unsafe fn of(array: *const cophase_array_f32, name: &str, wanted: [usize; 3]) -> Result<Self> {
        let array = unsafe { *place(array.cast_mut(), name)? };
        let given = [array.count, array.rows, array.cols];
        if given != wanted {
            let shape = |[count, rows, cols]: [usize; 3]| format!("{count} x {rows} x {cols}");
            let (given, wanted) = (shape(given), shape(wanted));
            return Err(Error::Shape(format!("{name} is {given} (count x rows x cols): {wanted} is accepted")));
        }
        let data = place(array.data, &format!("{name}->data"))?;
        let strides = [array.count_stride, array.row_stride, array.col_stride];
        check_reach(name, wanted, strides)?;
        Ok(Self { data, extents: wanted, strides })
    }

    /// Writes `value(k, y, x)` to every element.
    pub(super) fn fill(self, value: impl Fn(usize, usize, usize) -> f32) {
        let [count, rows, cols] = self.extents;
        for k in 0..count {
            for y in 0..rows {
                for x in 0..cols {
                    // No overflow: `check_reach` has been to the far corners.
                    let offset =
                        k as isize * self.strides[0] + y as isize * self.strides[1] + x as isize * self.strides[2];
                    unsafe { self.data.offset(offset).write(value(k, y, x)) };
                }
            }
        }
    }
}

/// Whether every element can be addressed, and no two are the same: in the order of their strides, each axis steps over
/// all that those before it reach.
fn check_reach(name: &str, extents: [usize; 3], strides: [isize; 3]) -> Result<()> {
    let refused = |what: &str| Error::Argument(format!("{name} has the strides {strides:?} for {extents:?}: {what}"));
    let mut axes: Vec<(usize, usize)> =
        extents.into_iter().zip(strides.map(isize::unsigned_abs)).filter(|&(extent, _)| extent > 1).collect();
    axes.sort_by_key(|&(_, stride)| stride);
    let mut reach = 0usize;
    for (extent, stride) in axes {
        if stride <= reach {
            return Err(refused("elements that do not overlap are accepted"));
        }
        reach = (extent - 1)
            .checked_mul(stride)
            .and_then(|span| span.checked_add(reach))
            // Elements on both sides of `data` are within this many bytes too.
            .filter(|&reach| reach <= isize::MAX as usize / size_of::<f32>())
            .ok_or_else(|| refused("elements within the address space are accepted"))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fills a 2 × 3 × 4 array in a row of `len` elements, starting at `start`.
    fn filled(len: usize, start: usize, strides: [isize; 3]) -> Vec<f32> {
        let mut memory = vec![0.0; len];
        let array = cophase_array_f32 {
            data: unsafe { memory.as_mut_ptr().add(start) },
            count: 2,
            rows: 3,
            cols: 4,
            count_stride: strides[0],
            row_stride: strides[1],
            col_stride: strides[2],
        };
        let output = unsafe { Output::of(&array, "array", [2, 3, 4]) }.unwrap();
        output.fill(|k, y, x| (100 * k + 10 * y + x) as f32 + 1.0);
        memory
    }

    #[test]
    fn elements_go_where_the_strides_say() {
        let c = filled(24, 0, [12, 4, 1]);
        assert_eq!(c[..6], [1.0, 2.0, 3.0, 4.0, 11.0, 12.0]);
        assert_eq!(c[12..14], [101.0, 102.0]);
        let columns = filled(24, 0, [12, 1, 3]);
        assert_eq!(columns[..6], [1.0, 11.0, 21.0, 2.0, 12.0, 22.0]);
        let stack_fastest = filled(24, 0, [1, 8, 2]);
        assert_eq!(stack_fastest[..4], [1.0, 101.0, 2.0, 102.0]);
        let backwards = filled(24, 23, [-12, -4, -1]);
        assert_eq!(backwards, c.iter().rev().copied().collect::<Vec<_>>());
        // In a window of a larger array, everything around it stays.
        let window = filled(2 * 6 * 5, 6, [30, 5, 1]);
        assert_eq!(window.iter().filter(|&&value| value == 0.0).count(), 60 - 24);
        assert_eq!(window[5..10], [0.0, 1.0, 2.0, 3.0, 4.0]);
    }

    #[test]
    fn overlap_and_overflow_are_refused() {
        let check = |extents, strides| check_reach("out", extents, strides).map_err(|error| error.to_string());
        for strides in [[0, 4, 1], [12, 0, 1], [12, 3, 1], [11, 4, 1], [12, 4, 0], [-11, 4, 1], [12, 2, 1]] {
            assert!(check([2, 3, 4], strides).unwrap_err().contains("do not overlap"), "{strides:?}");
        }
        // The stride of an extent of 1 does not matter, whatever it is.
        assert_eq!(check([1, 3, 4], [isize::MIN, 4, 1]), Ok(()));
        assert_eq!(check([2, 3, 4], [-12, 4, -1]), Ok(()));
        for stride in [isize::MAX, isize::MIN, isize::MAX / 4, -isize::MAX / 2] {
            let far = check([2, 3, 4], [stride, 4, 1]);
            assert!(far.as_ref().is_err_and(|sentence| sentence.contains("address space")), "{stride}: {far:?}");
        }
        assert!(check([2, 3, 4], [12, isize::MAX / 2, 1]).is_err());
    }
}
