//! Arrays that a caller hands in: five element types, any strides.

use super::pointer::source;
use crate::{Error, Result};
use ndarray::{Array2, Array3, Axis};
use std::ffi::c_void;

/// Element type of a cophase_input: float.
pub const COPHASE_F32: i32 = 1;
/// Element type of a cophase_input: double.
pub const COPHASE_F64: i32 = 2;
/// Element type of a cophase_input: uint16_t.
pub const COPHASE_U16: i32 = 3;
/// Element type of a cophase_input: int32_t.
pub const COPHASE_I32: i32 = 4;
/// Element type of a cophase_input: uint8_t.
pub const COPHASE_U8: i32 = 5;

/// Input array: a stack of `count` frames or maps of `rows` x `cols` elements (row = y, col = x).
/// It is only read, and only during the call.
///
/// Element (k, y, x) is at `data + k*count_stride + y*row_stride + x*col_stride`, in elements of
/// the given type. Strides may be negative, or 0 to repeat elements; the stride of an extent of 1
/// is ignored. C order is count_stride = rows*cols, row_stride = cols, col_stride = 1; MATLAB's
/// column order is row_stride = 1, col_stride = rows. The layout of this struct is permanent.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct cophase_input {
    /// Element (0, 0, 0); NULL for an optional array that is absent.
    pub data: *const c_void,
    /// COPHASE_F32, COPHASE_F64, COPHASE_U16, COPHASE_I32 or COPHASE_U8.
    pub element: i32,
    /// Frames or maps.
    pub count: usize,
    /// Rows of each.
    pub rows: usize,
    /// Columns of each.
    pub cols: usize,
    /// Elements from one frame to the next.
    pub count_stride: isize,
    /// Elements from one row to the next.
    pub row_stride: isize,
    /// Elements from one column to the next.
    pub col_stride: isize,
}

/// Input array in C order, without padding: what cophase_input has for
/// `float frames[count][rows][cols]`.
///
/// cophase_input frames = cophase_input_from_array(data, COPHASE_F32, 1, rows, cols);
///
/// Nothing is checked here: the call that takes the array does.
#[unsafe(no_mangle)]
pub extern "C" fn cophase_input_from_array(
    data: *const c_void,
    element: i32,
    count: usize,
    rows: usize,
    cols: usize,
) -> cophase_input {
    // More elements than memory has are refused by the call, with any strides.
    let stride = |extent: usize| isize::try_from(extent).unwrap_or(isize::MAX);
    let (count_stride, row_stride) = (stride(rows.saturating_mul(cols)), stride(cols));
    cophase_input { data, element, count, rows, cols, count_stride, row_stride, col_stride: 1 }
}

/// Element type.
trait Element: Copy {
    fn widen(self) -> f64;
}

macro_rules! elements {
    ($($element:ty),*) => { $(impl Element for $element {
        fn widen(self) -> f64 {
            f64::from(self)
        }
    })* };
}
elements!(f32, f64, u16, i32, u8);

/// An array that may be read.
#[derive(Debug, Clone, Copy)]
pub(super) struct Input<'a> {
    array: cophase_input,
    name: &'a str,
}

impl<'a> Input<'a> {
    /// The array that the argument `name` describes. The caller's promise: memory at every element,
    /// for as long as the call lasts.
    pub(super) unsafe fn new(array: *const cophase_input, name: &'a str) -> Result<Self> {
        let array = unsafe { *source(array, name)? };
        Self::checked(&array, name)
    }

    /// As [`Input::new`], for an array inside a struct that has been read; `None` where its data
    /// are NULL.
    pub(super) unsafe fn optional(array: &cophase_input, name: &'a str) -> Result<Option<Self>> {
        if array.data.is_null() { Ok(None) } else { Self::checked(array, name).map(Some) }
    }

    fn checked(array: &cophase_input, name: &'a str) -> Result<Self> {
        let bytes = match array.element {
            COPHASE_U8 => 1,
            COPHASE_U16 => 2,
            COPHASE_F32 | COPHASE_I32 => 4,
            COPHASE_F64 => 8,
            other => {
                let known = "COPHASE_F32, COPHASE_F64, COPHASE_U16, COPHASE_I32 or COPHASE_U8";
                return Err(Error::Argument(format!("{name}->element is {other}: {known} is accepted")));
            }
        };
        if array.data.is_null() {
            return Err(Error::Argument(format!("{name}->data is NULL: the address of the first element is accepted")));
        }
        if !array.data.addr().is_multiple_of(bytes) {
            let at = array.data;
            return Err(Error::Argument(format!(
                "{name}->data is {at:p}: an address that {bytes} divides is accepted"
            )));
        }
        let input = Self { array: *array, name };
        let [count, rows, cols] = input.shape();
        if [count, rows, cols].contains(&0) {
            return Err(Error::Shape(format!(
                "{name} is {count} x {rows} x {cols} (count x rows x cols): extents of 1 and more are accepted"
            )));
        }
        input.check_reach(bytes)?;
        Ok(input)
    }

    /// That every element can be addressed.
    fn check_reach(&self, bytes: usize) -> Result<()> {
        let strides = [self.array.count_stride, self.array.row_stride, self.array.col_stride];
        let far = self.shape().into_iter().zip(strides.map(isize::unsigned_abs)).try_fold(0usize, |reach, axis| {
            let (extent, stride) = axis;
            (extent - 1).checked_mul(if extent == 1 { 0 } else { stride })?.checked_add(reach)
        });
        match far.and_then(|reach| reach.checked_mul(bytes)) {
            Some(reach) if reach <= isize::MAX as usize - bytes => Ok(()),
            _ => Err(Error::Argument(format!(
                "{} has the strides {strides:?} for {:?}: elements within the address space are accepted",
                self.name,
                self.shape()
            ))),
        }
    }

    /// [count, rows, cols].
    pub(super) fn shape(&self) -> [usize; 3] {
        [self.array.count, self.array.rows, self.array.cols]
    }

    /// Refuses an array of another shape than `wanted`.
    pub(super) fn must_be(self, wanted: [usize; 3]) -> Result<Self> {
        if self.shape() != wanted {
            let shape = |[count, rows, cols]: [usize; 3]| format!("{count} x {rows} x {cols}");
            let (given, wanted) = (shape(self.shape()), shape(wanted));
            return Err(Error::Shape(format!("{} is {given} (count x rows x cols): {wanted} is accepted", self.name)));
        }
        Ok(self)
    }

    /// Calls `take(y, x, value)` for every element of frame `k`, which there must be.
    pub(super) fn each(&self, k: usize, take: impl FnMut(usize, usize, f64)) {
        debug_assert!(k < self.array.count);
        match self.array.element {
            COPHASE_F32 => self.each_of::<f32>(k, take),
            COPHASE_F64 => self.each_of::<f64>(k, take),
            COPHASE_U16 => self.each_of::<u16>(k, take),
            COPHASE_I32 => self.each_of::<i32>(k, take),
            // `checked` has seen that it is one of the five.
            _ => self.each_of::<u8>(k, take),
        }
    }

    fn each_of<T: Element>(&self, k: usize, mut take: impl FnMut(usize, usize, f64)) {
        let cophase_input { data, rows, cols, count_stride, row_stride, col_stride, .. } = self.array;
        // No overflow: `check_reach` has been to the far corners. The stride of an extent of 1 is
        // not used.
        let along = |index: usize, stride: isize| if index == 0 { 0 } else { index as isize * stride };
        for y in 0..rows {
            let row = along(k, count_stride) + along(y, row_stride);
            for x in 0..cols {
                let element = unsafe { data.cast::<T>().offset(row + along(x, col_stride)).read() };
                take(y, x, element.widen());
            }
        }
    }

    /// The only frame, `[y, x]`; [`Input::must_be`] must have checked that there is one.
    pub(super) fn map(&self) -> Result<Array2<f64>> {
        debug_assert!(self.array.count == 1);
        Ok(self.cube()?.index_axis_move(Axis(0), 0))
    }

    /// All of it, `[k, y, x]`.
    pub(super) fn cube(&self) -> Result<Array3<f64>> {
        let [count, rows, cols] = self.shape();
        let refused = || {
            Error::Shape(format!(
                "{} is {count} x {rows} x {cols} (count x rows x cols): as many elements as memory holds are accepted",
                self.name
            ))
        };
        // Strides of 0 describe more elements than there are: an extent can be anything.
        let size = count.checked_mul(rows).and_then(|size| size.checked_mul(cols)).ok_or_else(refused)?;
        let mut values = Vec::new();
        values.try_reserve_exact(size).map_err(|_| refused())?;
        for k in 0..count {
            self.each(k, |_, _, value| values.push(value));
        }
        Array3::from_shape_vec([count, rows, cols], values)
            .map_err(|error| Error::Internal(format!("the copy of {}: {error}", self.name)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn array<T>(memory: &[T], element: i32, start: usize, strides: [isize; 3]) -> cophase_input {
        cophase_input {
            data: memory[start..].as_ptr().cast(),
            element,
            count: 2,
            rows: 3,
            cols: 4,
            count_stride: strides[0],
            row_stride: strides[1],
            col_stride: strides[2],
        }
    }

    #[test]
    fn every_element_type_is_read_with_its_strides() {
        let plain: Vec<f64> = (0..24).map(f64::from).collect();
        let c_order = ndarray::Array3::from_shape_vec((2, 3, 4), plain.clone()).unwrap();
        let read = |input: cophase_input| unsafe { Input::new(&input, "frames") }.unwrap().cube().unwrap();
        let strides = [12, 4, 1];
        assert_eq!(read(array(&plain, COPHASE_F64, 0, strides)), c_order);
        assert_eq!(read(array(&plain.iter().map(|&v| v as f32).collect::<Vec<_>>(), COPHASE_F32, 0, strides)), c_order);
        assert_eq!(read(array(&plain.iter().map(|&v| v as u16).collect::<Vec<_>>(), COPHASE_U16, 0, strides)), c_order);
        assert_eq!(read(array(&plain.iter().map(|&v| v as u8).collect::<Vec<_>>(), COPHASE_U8, 0, strides)), c_order);
        let negative: Vec<i32> = plain.iter().map(|&v| -(v as i32)).collect();
        assert_eq!(read(array(&negative, COPHASE_I32, 0, strides)), -&c_order);
        let backwards = read(array(&plain, COPHASE_F64, 23, [-12, -4, -1]));
        assert_eq!(backwards, c_order.slice(ndarray::s![..;-1, ..;-1, ..;-1]));
        let columns = read(array(&plain, COPHASE_F64, 0, [12, 1, 3]));
        assert_eq!((columns[[1, 2, 3]], columns[[0, 1, 2]]), (23.0, 7.0));
        let repeated = read(array(&plain, COPHASE_F64, 0, [0, 4, 1]));
        assert_eq!(repeated.index_axis(ndarray::Axis(0), 1), c_order.index_axis(ndarray::Axis(0), 0));
    }

    #[test]
    fn an_array_in_c_order_needs_no_strides() {
        let plain: Vec<f32> = (0..24).map(|v| v as f32).collect();
        let input = cophase_input_from_array(plain.as_ptr().cast(), COPHASE_F32, 2, 3, 4);
        let read = unsafe { Input::new(&input, "frames") }.unwrap().cube().unwrap();
        assert_eq!(read.dim(), (2, 3, 4));
        assert!(read.iter().zip(0..).all(|(value, wanted)| *value == f64::from(wanted)));
        for extents in [[usize::MAX; 3], [1, 0, 4]] {
            let input =
                cophase_input_from_array(plain.as_ptr().cast(), COPHASE_F32, extents[0], extents[1], extents[2]);
            assert!(unsafe { Input::new(&input, "frames") }.is_err(), "{extents:?}");
        }
    }

    #[test]
    fn invalid_arrays_are_refused() {
        let memory = [0.0f64; 24];
        let good = array(&memory, COPHASE_F64, 0, [12, 4, 1]);
        let refused = |input: cophase_input| match unsafe { Input::new(&input, "frames") } {
            Err(error) => error.to_string(),
            Ok(input) => panic!("{input:?} was accepted"),
        };
        assert!(refused(cophase_input { element: 0, ..good }).starts_with("frames->element is 0:"));
        assert!(refused(cophase_input { data: std::ptr::null(), ..good }).starts_with("frames->data is NULL:"));
        let odd = unsafe { good.data.byte_add(4) };
        assert!(refused(cophase_input { data: odd, ..good }).contains("that 8 divides"));
        assert!(refused(cophase_input { count: 0, ..good }).starts_with("frames is 0 x 3 x 4"));
        for stride in [isize::MAX, isize::MIN, isize::MAX / 16] {
            assert!(refused(cophase_input { row_stride: stride, ..good }).contains("address space"), "{stride}");
        }
        assert!(refused(cophase_input { rows: usize::MAX, cols: usize::MAX, ..good }).contains("address space"));
        for count in [usize::MAX, usize::MAX / 16, 1 << 50] {
            let many = cophase_input { count, count_stride: 0, ..good };
            let sentence = unsafe { Input::new(&many, "frames") }.unwrap().cube().unwrap_err().to_string();
            assert!(sentence.contains("elements") && sentence.contains("memory"), "{sentence}");
        }
        // An extent of 1 has no stride.
        assert!(unsafe { Input::new(&cophase_input { count: 1, count_stride: isize::MIN, ..good }, "frames") }.is_ok());
        let wrong = unsafe { Input::new(&good, "frames") }.unwrap().must_be([2, 4, 3]).unwrap_err().to_string();
        let facts = ["frames is 2 x 3 x 4", "count x rows x cols", "2 x 4 x 3"];
        assert!(facts.iter().all(|fact| wrong.contains(fact)), "{wrong}");
    }
}
