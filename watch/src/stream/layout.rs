//! Layout of a stream of ImageStreamIO in its shared memory file (`ImageStruct.h`, version 2.00):
//! metadata, pixels, keywords, semaphores, traces, circular buffer, each rounded up to 8 bytes.

use cophase::{Error, Result};
use std::mem::{offset_of, size_of};

/// The version of the structure that is read.
const VERSION: &[u8] = b"2.00\0";
/// Bytes of an `IMAGE_KEYWORD`, a `STREAM_PROC_TRACE` and a `CBFRAMEMD`.
const KEYWORD: u64 = 128;
const TRACE: u64 = 64;
const BUFFER_METADATA: u64 = 48;
/// Bits of `imagetype`: the slices of a cube are times.
const CIRCULAR_BUFFER: u64 = 0x1;
const TEMPORAL: u64 = 0x20000;
const CIRCULAR_BITS: u64 = 0xF000F;
/// Largest number of pixels, a bound on what a damaged file can ask for.
const MOST_PIXELS: u64 = 1 << 26;

#[repr(C)]
struct Timespec {
    seconds: i64,
    nanoseconds: i64,
}

/// `IMAGE_METADATA`, for the places of its fields.
#[repr(C)]
struct Metadata {
    version: [u8; 32],
    name: [u8; 80],
    naxis: u8,
    size: [u32; 3],
    nelement: u64,
    datatype: u8,
    imagetype: u64,
    creationtime: Timespec,
    lastaccesstime: Timespec,
    atime: Timespec,
    writetime: Timespec,
    creator_pid: i32,
    owner_pid: i32,
    shared: u8,
    inode: u64,
    location: i8,
    status: u8,
    flag: u64,
    logflag: u8,
    sem: u16,
    nb_proctrace: u16,
    cnt0: u64,
    cnt1: u64,
    cnt2: u64,
    write: u8,
    nb_kw: u16,
    cb_size: u32,
    cb_index: u32,
    cb_cycle: u64,
    imdatamemsize: u64,
    cuda_mem_handle: [u8; 64],
}

/// Bytes at the beginning of the file that [`Header::parse`] needs.
pub const METADATA: usize = size_of::<Metadata>();

/// Type of the pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pixels {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

/// Where recent frames are kept besides the newest one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ring {
    /// Place of the first slot in the file.
    pub offset: u64,
    pub slots: u64,
    /// Slot of the newest frame.
    pub newest: u64,
}

/// Metadata of a stream at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    pub columns: usize,
    pub rows: usize,
    pub pixels: Pixels,
    /// Number of frames that were written.
    pub count: u64,
    /// Whether a frame is being written.
    pub is_written: bool,
    /// When the newest frame was acquired, s since 1970.
    pub acquired_s: f64,
    /// When the newest frame was written, s since 1970.
    pub written_s: f64,
    /// When the stream was made: with the counter it is the identity of a frame.
    pub created: [i64; 2],
    /// Number of semaphores.
    pub semaphores: usize,
    /// Place of the semaphores, and of the numbers of the processes that wait for them.
    pub semaphores_at: u64,
    pub readers_at: u64,
    /// Place of the newest frame.
    pub data_at: u64,
    pub ring: Option<Ring>,
    /// Size of the file.
    pub file_bytes: u64,
}

impl Pixels {
    fn of(code: u8) -> Option<Self> {
        Some(match code {
            1 => Self::U8,
            2 => Self::I8,
            3 => Self::U16,
            4 => Self::I16,
            5 => Self::U32,
            6 => Self::I32,
            7 => Self::U64,
            8 => Self::I64,
            9 => Self::F32,
            10 => Self::F64,
            _ => return None,
        })
    }

    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::U64 | Self::I64 | Self::F64 => 8,
        }
    }

    /// The numbers in `bytes`, in the order of this machine, which wrote them.
    pub fn numbers(self, bytes: &[u8]) -> Vec<f64> {
        macro_rules! read {
            ($type:ty) => {
                bytes
                    .chunks_exact(size_of::<$type>())
                    .map(|chunk| chunk.try_into().map_or(f64::NAN, |chunk| <$type>::from_ne_bytes(chunk) as f64))
                    .collect()
            };
        }
        match self {
            Self::U8 => read!(u8),
            Self::I8 => read!(i8),
            Self::U16 => read!(u16),
            Self::I16 => read!(i16),
            Self::U32 => read!(u32),
            Self::I32 => read!(i32),
            Self::U64 => read!(u64),
            Self::I64 => read!(i64),
            Self::F32 => read!(f32),
            Self::F64 => read!(f64),
        }
    }
}

impl Header {
    /// The metadata in `bytes`, the beginning of a file of `file_bytes`.
    ///
    /// # Errors
    /// [`Error::Image`] for another version of the structure, pixels that are no real numbers in
    /// the memory of this machine, and a file whose size is not the one of its contents.
    pub fn parse(bytes: &[u8; METADATA], file_bytes: u64) -> Result<Self> {
        if !bytes.starts_with(VERSION) {
            let version = String::from_utf8_lossy(&bytes[..8]);
            let version = version.trim_end_matches('\0');
            return Err(refused(format!(
                "has version '{version}' of the structure of ImageStreamIO: 2.00 is accepted"
            )));
        }
        let axes = bytes[offset_of!(Metadata, naxis)];
        let size = [0, 1, 2].map(|axis| u64::from(u32_at(bytes, offset_of!(Metadata, size) + 4 * axis)));
        let slices = if axes == 3 { size[2] } else { 1 };
        if !(2..=3).contains(&axes) || size[0] == 0 || size[1] == 0 || slices == 0 || size[0] * size[1] > MOST_PIXELS {
            return Err(refused(format!(
                "has {axes} axes and {}x{} pixels: an image is accepted, or a cube of them",
                size[0], size[1]
            )));
        }
        let kind = u64_at(bytes, offset_of!(Metadata, imagetype));
        let is_circular = kind & CIRCULAR_BITS == CIRCULAR_BUFFER | TEMPORAL;
        if axes == 3 && kind & CIRCULAR_BUFFER == 0 && slices > 1 {
            return Err(refused(format!(
                "is a cube of {slices} images that are no times: a circular buffer is accepted"
            )));
        }
        let code = bytes[offset_of!(Metadata, datatype)];
        let pixels = Pixels::of(code).ok_or_else(|| {
            refused(format!(
                "has pixels of type {code} of ImageStreamIO: integers, and real numbers of 32 and 64 bits are accepted"
            ))
        })?;
        if (bytes[offset_of!(Metadata, location)] as i8) >= 0 {
            return Err(refused("has its pixels on a GPU: a stream in the memory of the CPU is accepted".into()));
        }
        let frame_bytes = size[0] * size[1] * pixels.bytes() as u64;
        let data_bytes = u64_at(bytes, offset_of!(Metadata, imdatamemsize));
        let semaphores = u64::from(u16_at(bytes, offset_of!(Metadata, sem)));
        let (keywords, traces) =
            (u16_at(bytes, offset_of!(Metadata, nb_kw)), u16_at(bytes, offset_of!(Metadata, nb_proctrace)));
        let buffer = u64::from(u32_at(bytes, offset_of!(Metadata, cb_size)));
        let semaphore = size_of::<libc::sem_t>() as u64;
        let mut end = round(METADATA as u64);
        let mut take = |bytes: u64| {
            let begin = end;
            end = end.saturating_add(round(bytes));
            begin
        };
        let data_at = take(data_bytes);
        take(KEYWORD * u64::from(keywords));
        let semaphores_at = take(semaphore * semaphores);
        take(semaphore);
        let readers_at = take(4 * semaphores);
        for bytes in [4 * semaphores, 4 * semaphores, 4 * semaphores, TRACE * u64::from(traces)] {
            take(bytes);
        }
        if is_circular {
            for bytes in [16 * slices, 16 * slices, 8 * slices] {
                take(bytes);
            }
        }
        take(BUFFER_METADATA * buffer);
        let buffer_at = take(data_bytes.saturating_mul(buffer));
        if data_bytes != frame_bytes * slices || end != file_bytes {
            return Err(refused(format!(
                "has {file_bytes} bytes, where its metadata say {end}: a stream of ImageStreamIO in its usual form is accepted"
            )));
        }
        let ring = if buffer > 0 && slices == 1 {
            let newest = u64::from(u32_at(bytes, offset_of!(Metadata, cb_index)));
            Some(Ring { offset: buffer_at, slots: buffer, newest })
        } else if slices > 1 {
            Some(Ring { offset: data_at, slots: slices, newest: u64_at(bytes, offset_of!(Metadata, cnt1)) })
        } else {
            None
        };
        let time = |offset: usize| i64_at(bytes, offset) as f64 + i64_at(bytes, offset + 8) as f64 * 1e-9;
        let created = offset_of!(Metadata, creationtime);
        Ok(Self {
            columns: size[0] as usize,
            rows: size[1] as usize,
            pixels,
            count: u64_at(bytes, offset_of!(Metadata, cnt0)),
            is_written: bytes[offset_of!(Metadata, write)] != 0,
            acquired_s: time(offset_of!(Metadata, atime)),
            written_s: time(offset_of!(Metadata, writetime)),
            created: [i64_at(bytes, created), i64_at(bytes, created + 8)],
            semaphores: semaphores as usize,
            semaphores_at,
            readers_at,
            data_at,
            ring: ring.filter(|ring| ring.newest < ring.slots),
            file_bytes,
        })
    }

    /// Counter less slot of the newest frame, modulo the slots; `None` without a ring.
    pub fn phase(&self) -> Option<u64> {
        self.ring.map(|ring| (self.count % ring.slots + ring.slots - ring.newest) % ring.slots)
    }

    /// Bytes of a frame.
    pub fn frame_bytes(&self) -> usize {
        self.columns * self.rows * self.pixels.bytes()
    }
}

fn refused(reason: String) -> Error {
    Error::Image(format!("the stream {reason}"))
}

fn round(bytes: u64) -> u64 {
    bytes.saturating_add(7) & !7
}

fn array<const N: usize>(bytes: &[u8], offset: usize) -> [u8; N] {
    let mut array = [0; N];
    array.copy_from_slice(&bytes[offset..offset + N]);
    array
}

fn u16_at(bytes: &[u8], offset: usize) -> u16 {
    u16::from_ne_bytes(array(bytes, offset))
}

fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    u32::from_ne_bytes(array(bytes, offset))
}

fn u64_at(bytes: &[u8], offset: usize) -> u64 {
    u64::from_ne_bytes(array(bytes, offset))
}

fn i64_at(bytes: &[u8], offset: usize) -> i64 {
    i64::from_ne_bytes(array(bytes, offset))
}
