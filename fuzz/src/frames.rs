//! Arrays across the C boundary. A caller owes memory at every element that it describes, so an
//! input that would lie about that is not tried; everything else is: shapes, strides, addresses,
//! elements, and the bytes of the pixels.

use cophase::capi::*;
use std::ffi::CString;
use std::ptr;

/// Seven segments on as few samples as show them: a fit takes a millisecond.
const SCENE: &str = "
[pupil]
aperture = \"hexagonal\"
rings = 1
grid_m = 4.8
samples = 16
[image]
wavelength_nm = 2168.6
samples_per_lambda_over_d = 2
pixels = 24
diversity_focus_waves_rms = 0.5
read_noise_e = 10.0
[modes]
segment = \"piston\"
ncpa = \"zernike\"
ncpa_count = 3
exact_zernikes = []
[estimate]
max_evaluations = 30
";

/// Most frames of a call.
const CAPACITY: usize = 2;

/// Bytes that the caller has: two frames and something beside them, at the widest element.
const MEMORY_BYTES: usize = 8 * 4000;

/// Bytes of an input before those of the pixels.
const DESCRIPTION: usize = 40;

/// A model and a session, made once.
pub struct Session {
    model: *mut cophase_model,
    session: *mut cophase_session,
    side: usize,
    modes: usize,
}

impl Session {
    pub fn new() -> Self {
        let scene = CString::new(SCENE).expect("no zero byte");
        let (mut model, mut session) = (ptr::null_mut(), ptr::null_mut());
        // SAFETY: zeros are values of both structs, and the defaults of the options.
        let (mut info, mut options) =
            unsafe { (std::mem::zeroed::<cophase_model_info>(), std::mem::zeroed::<cophase_session_options>()) };
        (options.struct_size, options.capacity) = (size_of_val(&options), CAPACITY);
        // SAFETY: live locals, and handles that the calls before made.
        let made = unsafe {
            [
                cophase_model_create(scene.as_ptr(), ptr::null(), ptr::null(), &mut model),
                cophase_model_get_info(model, &mut info, size_of::<cophase_model_info>()),
                cophase_session_create(model, &options, &mut session),
            ]
        };
        assert_eq!(made, [COPHASE_OK; 3], "{}", sentence());
        assert_eq!(info.rows, info.cols);
        Self { model, session, side: info.rows, modes: info.modes }
    }

    /// Describes an array as `input` says, calibrates with it and fits it; gives whether it was
    /// fitted.
    pub fn probe(&self, input: &[u8]) -> bool {
        let (description, pixels) = input.split_at(input.len().min(DESCRIPTION));
        let mut take = Bytes(description);
        let memory = memory(pixels);
        let array = self.array(&mut take, &memory);
        if !self.honest(&array, &memory) {
            return false;
        }
        let (deadline_s, read_noise_e) = (take.real(), take.real());
        let (begins, calibrates) = (take.byte() & 1 == 1, take.byte() % 8 == 7);
        let start_nm: Vec<f64> = (0..CAPACITY * self.modes).map(|_| take.real()).collect();
        let options = cophase_fit_options {
            struct_size: size_of::<cophase_fit_options>(),
            deadline_s,
            read_noise_e,
            start_nm: if begins { start_nm.as_ptr() } else { ptr::null() },
            has_read_noise: i64::from(begins),
        };
        // SAFETY: `honest` has seen that every element of `array` lies in `memory`, or that it must
        // be refused unread.
        unsafe {
            if calibrates {
                self.calibrate(array, &mut take);
            }
            let fitted = self.fit(&array, &options);
            refusal(cophase_session_calibrate(self.session, 0, ptr::null()));
            fitted
        }
    }

    unsafe fn calibrate(&self, array: cophase_input, take: &mut Bytes) {
        // SAFETY: zeros are the defaults; of the rest as the caller says.
        unsafe {
            let mut calibration = std::mem::zeroed::<cophase_calibration>();
            calibration.struct_size = size_of_val(&calibration);
            match take.byte() % 3 {
                0 => calibration.dark = array,
                1 => calibration.flat = array,
                _ => calibration.bad = array,
            }
            (calibration.gain_e, calibration.saturation) = (take.real(), take.real());
            refusal(cophase_session_calibrate(self.session, 0, &calibration));
        }
    }

    /// Fits twice: the second time must give the same bits.
    unsafe fn fit(&self, array: &cophase_input, options: &cophase_fit_options) -> bool {
        let mut found = [(); 2].map(|()| vec![7.0; CAPACITY * self.modes]);
        let mut status = 0;
        for coefficients in &mut found {
            // SAFETY: as the caller says; room for as many coefficients as the session may give.
            status = unsafe {
                let (session, out) = (self.session, coefficients.as_mut_ptr());
                let (sigma, images, groups) = (ptr::null_mut(), ptr::null_mut(), ptr::null_mut());
                cophase_session_fit(session, array, 1, options, out, sigma, self.modes, images, 0, groups, 0)
            };
            refusal(status);
        }
        if status != COPHASE_OK {
            assert!(found[0].iter().all(|&nm| nm == 7.0), "a call that failed has written");
            return false;
        }
        let bits = |list: &[f64]| list.iter().map(|nm| nm.to_bits()).collect::<Vec<_>>();
        // A deadline stops a fit where it is; without one a frame has one answer.
        assert!(options.deadline_s > 0.0 || bits(&found[0]) == bits(&found[1]), "{found:?}");
        for image in found[0].chunks_exact(self.modes).take(array.count) {
            let known = image.iter().filter(|nm| nm.is_finite()).count();
            assert!(known == 0 || known == self.modes, "coefficients partly finite: {image:?}");
            assert!(known == self.modes || image.iter().all(|nm| nm.is_nan()), "{image:?}");
        }
        true
    }

    fn array(&self, take: &mut Bytes, memory: &[u64]) -> cophase_input {
        let side = self.side;
        let mut extent = |wanted: usize| match take.byte() {
            0..=207 => wanted,
            208..=215 => 0,
            216..=223 => wanted + 1,
            224..=231 => 1,
            232..=239 => usize::MAX,
            other => usize::from(other) << 20,
        };
        let [count, rows, cols] = [extent(1), extent(side), extent(side)];
        let count = if count == 1 && take.byte() & 1 == 1 { CAPACITY } else { count };
        let mut stride = |wanted: usize| match take.byte() {
            0..=191 => wanted as isize,
            192..=207 => 0,
            208..=223 => -(wanted as isize),
            224..=231 => isize::MIN,
            232..=239 => isize::MAX,
            other => isize::from(other) - 247,
        };
        let strides = [stride(side * side), stride(side), stride(1)];
        let element =
            [COPHASE_F32, COPHASE_F64, COPHASE_U16, COPHASE_I32, COPHASE_U8, 0, -1, 6][take.byte() as usize % 8];
        let start = match take.byte() {
            0..=191 => 0,
            other => 37 * (usize::from(other) - 191),
        };
        let first = memory.as_ptr().cast::<u8>();
        let data = if take.byte() == 255 { ptr::null() } else { first.wrapping_add(start) };
        cophase_input {
            data: data.cast(),
            element,
            count,
            rows,
            cols,
            count_stride: strides[0],
            row_stride: strides[1],
            col_stride: strides[2],
        }
    }

    /// Whether a caller may hand in `array`: it has all the memory that the array describes, or
    /// describes one whose shape or reach is refused before anything is read.
    fn honest(&self, array: &cophase_input, memory: &[u64]) -> bool {
        let bytes = match array.element {
            COPHASE_U8 => 1,
            COPHASE_U16 => 2,
            COPHASE_F32 | COPHASE_I32 => 4,
            COPHASE_F64 => 8,
            _ => return true,
        };
        let (extents, shape) = ([array.count, array.rows, array.cols], [self.side; 2]);
        if extents.contains(&0)
            || extents[1..] != shape
            || !(1..=CAPACITY).contains(&array.count)
            || array.data.is_null()
        {
            return true;
        }
        let strides = [array.count_stride, array.row_stride, array.col_stride];
        let first = array.data.addr() as i128 - memory.as_ptr().addr() as i128;
        let (mut low, mut high) = (first, first + bytes - 1);
        for (extent, stride) in extents.into_iter().zip(strides) {
            let reach = (extent as i128 - 1) * stride as i128 * bytes;
            (low, high) = (low + reach.min(0), high + reach.max(0));
        }
        let overflows = high - low > isize::MAX as i128;
        overflows || (low >= 0 && high < size_of_val(memory) as i128)
    }
}

impl Default for Session {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        // SAFETY: handles of our own, given back once.
        unsafe {
            cophase_session_destroy(self.session);
            cophase_model_destroy(self.model);
        }
    }
}

/// The bytes of an input, then zeros.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn byte(&mut self) -> u8 {
        let Some((&first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        first
    }

    /// A number of the kinds that break things.
    fn real(&mut self) -> f64 {
        match self.byte() {
            0 => 0.0,
            1 => f64::NAN,
            2 => f64::INFINITY,
            3 => -1.0,
            4 => f64::MIN_POSITIVE / 2.0,
            5 => f64::MAX,
            6 => 1e-300,
            7 => 1e12,
            other => f64::from(other) / 4.0,
        }
    }
}

/// The caller's memory: the bytes of the input, over and over.
fn memory(pixels: &[u8]) -> Vec<u64> {
    let mut bytes = pixels.iter().copied().cycle();
    (0..MEMORY_BYTES / 8).map(|_| u64::from_le_bytes([(); 8].map(|()| bytes.next().unwrap_or(0)))).collect()
}

/// That a status is none that says that the library broke its promise, and comes with a sentence
/// where it refuses.
fn refusal(status: i32) {
    assert!(![COPHASE_PANIC, COPHASE_INTERNAL].contains(&status), "status {status}: {}", sentence());
    assert!(status == COPHASE_OK || sentence().lines().count() == 1, "status {status}: {:?}", sentence());
}

fn sentence() -> String {
    let mut text = [0_u8; 2048];
    // SAFETY: as much room as is said.
    let length = unsafe { cophase_last_error(text.as_mut_ptr().cast(), text.len()) };
    String::from_utf8_lossy(&text[..length.min(text.len() - 1)]).into_owned()
}
