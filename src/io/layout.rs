//! Layout of a FITS file: reads and validates all headers before cfitsio does.
//!
//! Every size is compared with the length of the file, so that a malformed or malicious header
//! cannot cause a large allocation or a long loop. Headers are converted to standard form, and
//! repairs are recorded.

use std::io::{Read, Seek, SeekFrom};

use super::card::{self, BLOCK, Bytes, CARD};
use super::repair::{self, Repairs};

/// Longest accepted header, in cards (8 MB): real headers have hundreds.
const MAX_CARDS: usize = 100_000;

/// Bytes of such a header.
pub(super) const MAX_HEADER: u64 = (MAX_CARDS * CARD) as u64;

/// Largest accepted number of HDUs: real files have tens.
const MAX_HDUS: usize = 10_000;

/// Largest accepted number of pixels of an image: 16 GiB as f64.
const MAX_PIXELS: u64 = 1 << 31;

/// Content of an HDU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum HduKind {
    Image,
    Table,
    /// A binary table with a tile-compressed image, before it is unpacked, or where it cannot be.
    Compressed,
    Other,
}

/// One HDU of a file.
#[derive(Debug, Clone)]
pub(super) struct Hdu {
    pub kind: HduKind,
    /// `EXTNAME` in upper case; without it `PRIMARY` for the first HDU, empty for others.
    pub name: String,
    pub bitpix: i64,
    /// NAXIS1 (fastest) first.
    pub axes: Vec<u64>,
    /// The whole header in standard form, a multiple of [`BLOCK`].
    pub header: Vec<u8>,
    /// Offset of the header, and of the data, in the original file.
    pub header_at: u64,
    pub data_at: u64,
    /// Bytes of data, without padding.
    pub data_bytes: u64,
    /// Why a tile-compressed image is not unpacked; empty for other HDUs.
    pub refusal: String,
}

impl Hdu {
    /// The value of the first card `key`, with the quotes of a string.
    pub fn value(&self, key: &str) -> Option<&str> {
        self.value_and_comment(key).map(|(value, _)| value)
    }

    /// The value of the first card `key`, with the quotes of a string, and its comment.
    pub fn value_and_comment(&self, key: &str) -> Option<(&str, &str)> {
        let cards = self.header.as_chunks::<CARD>().0;
        if card::is_hierarchical(key) {
            return cards.iter().find_map(|found| card::hierarchical_value(found, key));
        }
        let found = cards.iter().find(|found| card::keyword(found) == key.as_bytes())?;
        card::value_and_comment(found)
    }

    /// What is wrong with the scale and the offset of its values, whose cards these are, as a
    /// sentence: real = scale · stored + offset.
    pub fn scaling_fault(&self, [scale, offset]: [&str; 2]) -> Option<String> {
        let fault = |key: &str, accepts_zero: bool| {
            let value = self.value(key).filter(|value| !value.is_empty())?;
            // Fortran writes the exponent of a double with a D. A number beyond all doubles is
            // infinite.
            let number = value.replace(['D', 'd'], "E").parse::<f64>().ok();
            let is_accepted = number.is_some_and(|number| number.is_finite() && (accepts_zero || number != 0.0));
            let accepted = if accepts_zero { "a finite number" } else { "a finite number other than 0" };
            (!is_accepted)
                .then(|| format!("the card {key} of {} is {value}, where {accepted} is needed", self.described()))
        };
        fault(scale, false).or_else(|| fault(offset, true))
    }

    /// Columns of a table, in order.
    pub fn columns(&self) -> Vec<String> {
        let fields = self.value("TFIELDS").and_then(card::integer).unwrap_or(0).clamp(0, 999);
        (1..=fields).map(|n| self.value(&format!("TTYPE{n}")).map(card::text).unwrap_or_default()).collect()
    }

    /// EXTVER, the number among the HDUs of its name.
    pub fn version(&self) -> Option<i64> {
        self.value("EXTVER").and_then(card::integer)
    }

    /// Whether `text` names this HDU: its name, or `NAME,2` for the HDU of that name with EXTVER 2
    /// (1 where it has none).
    pub fn is_named(&self, text: &str) -> bool {
        let is_name = |name: &str| self.name.eq_ignore_ascii_case(name.trim());
        let (name, version) = name_and_version(text);
        is_name(text) || (version.is_some_and(|version| version == self.version().unwrap_or(1)) && is_name(name))
    }

    /// Description for messages: the name, or the place in the file.
    pub fn described(&self) -> String {
        if self.name.is_empty() { format!("the HDU at byte {}", self.header_at) } else { format!("`{}`", self.name) }
    }
}

/// Name and EXTVER of an HDU, from `NAME` or `NAME,version`.
pub(super) fn name_and_version(text: &str) -> (&str, Option<i64>) {
    let parts = text.rsplit_once(',').and_then(|(name, version)| Some((name, version.trim().parse().ok()?)));
    parts.map_or((text, None), |(name, version)| (name, Some(version)))
}

/// The HDUs of a file, and the repairs of their headers.
#[derive(Debug)]
pub(super) struct Layout {
    pub hdus: Vec<Hdu>,
    pub repairs: Repairs,
}

impl Layout {
    /// Whether an HDU is a tile-compressed image.
    pub fn holds_compressed(&self) -> bool {
        self.hdus.iter().any(|hdu| hdu.kind == HduKind::Compressed)
    }
}

/// Reads all headers of `source`, which has `length` bytes.
///
/// # Errors
/// Why the file cannot be read as FITS, with the offset of the first wrong byte.
pub(super) fn scan(source: &mut (impl Read + Seek), length: u64) -> Result<Layout, String> {
    if length == 0 {
        return Err("the file is empty (0 bytes): a FITS file has at least 2880".into());
    }
    let mut layout = Layout { hdus: Vec::new(), repairs: Repairs::default() };
    let mut at = 0;
    while at < length {
        if layout.hdus.len() == MAX_HDUS {
            return Err(format!(
                "there are more than {MAX_HDUS} HDUs, up to byte {at}: at most {MAX_HDUS} are accepted"
            ));
        }
        let Some(hdu) = read_hdu(source, at, length, &mut layout.repairs)? else {
            layout.repairs.add(format!("{} bytes after the last HDU ignored", length - at), at);
            break;
        };
        let end = hdu.data_at + hdu.data_bytes;
        if end > length {
            return Err(format!(
                "the file is truncated: {} needs {end} bytes in total (its data start at byte {}), and {length} are present",
                hdu.described(),
                hdu.data_at
            ));
        }
        at = end.next_multiple_of(BLOCK);
        if at > length && hdu.data_bytes > 0 {
            layout.repairs.add("missing padding at the end added".into(), length);
        }
        layout.hdus.push(hdu);
    }
    Ok(layout)
}

/// Bytes of data that the header at byte `at` declares; `None` where no HDU starts there. `source`
/// has `length` bytes, up to the end of the header.
///
/// # Errors
/// As [`scan`].
pub(super) fn declared_bytes(source: &mut (impl Read + Seek), at: u64, length: u64) -> Result<Option<u64>, String> {
    let hdu = read_hdu(source, at, length, &mut Repairs::default())?;
    Ok(hdu.map(|hdu| hdu.data_bytes))
}

/// The HDU at byte `at`; `None` where an extension cannot start there.
fn read_hdu(
    source: &mut (impl Read + Seek),
    at: u64,
    length: u64,
    repairs: &mut Repairs,
) -> Result<Option<Hdu>, String> {
    let primary = at == 0;
    source.seek(SeekFrom::Start(at)).map_err(|error| format!("byte {at} cannot be reached: {error}"))?;
    let mut raw = Vec::new();
    let mut cards: Vec<Bytes> = Vec::new();
    let mut found = Repairs::default();
    let mut ended = false;
    while !ended {
        let before = raw.len();
        // One block at a time, so that a file without END is not read completely before its first
        // card is checked.
        let block = source.by_ref().take(BLOCK).read_to_end(&mut raw);
        let got = block.map_err(|error| format!("byte {} cannot be read: {error}", at + before as u64))?;
        let short = (got as u64) < BLOCK;
        raw.resize(before + BLOCK as usize, b' ');
        for (i, original) in raw[before..].as_chunks::<CARD>().0.iter().enumerate() {
            let offset = at + (before + i * CARD) as u64;
            if offset == at && !repair::starts_hdu(original, primary) {
                return if primary { Err(not_fits(original)) } else { Ok(None) };
            }
            let repaired = repair::card(original, offset, &mut found);
            if repair::is_end(&repaired) {
                repair::check_fill(&raw[before + (i + 1) * CARD..], offset + CARD as u64, &mut found);
                ended = true;
                break;
            }
            cards.push(repaired);
        }
        if short && ended {
            found.add("missing padding of a header added".into(), length);
        }
        if !ended && (short || cards.len() >= MAX_CARDS) {
            let last = at + raw.len() as u64;
            return Err(format!(
                "the header at byte {at} has no END card in the {} bytes read of it, up to byte {}",
                last.min(length) - at,
                last.min(length)
            ));
        }
    }
    let shape = HduShape::new(&cards, at, primary)?;
    let header = repair::standard_header(cards, &shape.mandatory, at, &mut found);
    repairs.append(found);
    let data_at = at + raw.len() as u64;
    let mut hdu = Hdu {
        kind: shape.kind,
        name: String::new(),
        bitpix: shape.bitpix,
        axes: shape.axes,
        header,
        header_at: at,
        // A file may end within the padding of its last header.
        data_at: if shape.data_bytes == 0 { data_at.min(length) } else { data_at },
        data_bytes: shape.data_bytes,
        refusal: String::new(),
    };
    hdu.name = hdu.value("EXTNAME").map(card::text).unwrap_or_default().trim().to_uppercase();
    if hdu.name.is_empty() && primary {
        hdu.name = "PRIMARY".into();
    }
    Ok(Some(hdu))
}

fn not_fits(first: &Bytes) -> String {
    let start: String = first[..8].iter().map(|&b| if matches!(b, 32..=126) { b as char } else { '.' }).collect();
    format!("not a FITS file: byte 0 starts with `{start}`, where the card `SIMPLE  =` is needed")
}

/// Type and size of an HDU, from its mandatory cards.
struct HduShape {
    kind: HduKind,
    bitpix: i64,
    axes: Vec<u64>,
    data_bytes: u64,
    /// Keyword and value of each mandatory card, in the standard's order.
    mandatory: Vec<(String, String)>,
}

impl HduShape {
    fn new(cards: &[Bytes], at: u64, primary: bool) -> Result<Self, String> {
        let numbers = HeaderIntegers { cards, at };
        let (kind, first) = if primary { (HduKind::Image, ("SIMPLE", "T".to_string())) } else { extension(&cards[0]) };
        let bitpix = numbers.needed("BITPIX")?;
        if !matches!(bitpix, 8 | 16 | 32 | 64 | -32 | -64) {
            return Err(numbers.refusal("BITPIX", bitpix, "8, 16, 32, 64, -32 or -64"));
        }
        let naxis = numbers.needed("NAXIS")?;
        if !(0..=999).contains(&naxis) {
            return Err(numbers.refusal("NAXIS", naxis, "0 to 999"));
        }
        let mut mandatory: Vec<_> = vec![(first.0.to_string(), first.1)];
        mandatory.push(("BITPIX".into(), bitpix.to_string()));
        mandatory.push(("NAXIS".into(), naxis.to_string()));
        let mut axes = Vec::new();
        for n in 1..=naxis {
            let key = format!("NAXIS{n}");
            let size = numbers.needed(&key)?;
            axes.push(u64::try_from(size).map_err(|_| numbers.refusal(&key, size, "0 or more"))?);
            mandatory.push((key, size.to_string()));
        }
        let data_bytes = numbers.data_bytes(kind, primary, bitpix, &axes, &mut mandatory)?;
        Ok(Self { kind: numbers.compressed(kind), bitpix, axes, data_bytes, mandatory })
    }
}

/// Kind of an extension, and its first card.
fn extension(first: &Bytes) -> (HduKind, (&'static str, String)) {
    let value = card::value_and_comment(first).map(|(value, _)| card::text(value)).unwrap_or_default();
    let name = value.trim().to_uppercase();
    let kind = match name.as_str() {
        "IMAGE" | "IUEIMAGE" => HduKind::Image,
        "TABLE" | "BINTABLE" | "A3DTABLE" => HduKind::Table,
        _ => HduKind::Other,
    };
    (kind, ("XTENSION", format!("'{name:<8}'")))
}

/// The integers among a header's cards.
struct HeaderIntegers<'a> {
    cards: &'a [Bytes],
    at: u64,
}

impl HeaderIntegers<'_> {
    /// Offset and value of the card `key`, which may be repeated only with the same value.
    fn find(&self, key: &str) -> Result<Option<(u64, i64)>, String> {
        let mut found = None;
        for (i, card) in self.cards.iter().enumerate().filter(|(_, card)| card::keyword(card) == key.as_bytes()) {
            let offset = self.at + (i * CARD) as u64;
            let value = card::value_and_comment(card).map_or("", |(value, _)| value);
            let number = card::integer(value).ok_or_else(|| {
                format!("the card {key} at byte {offset} has the value `{value}`, where an integer is needed")
            })?;
            match found {
                None => found = Some((offset, number)),
                Some((_, before)) if before == number => {}
                Some((_, before)) => {
                    return Err(format!(
                        "the card {key} is present twice, as {before} and, at byte {offset}, as {number}: one value is needed"
                    ));
                }
            }
        }
        Ok(found)
    }

    fn needed(&self, key: &str) -> Result<i64, String> {
        let found = self.find(key)?;
        found
            .map(|(_, n)| n)
            .ok_or_else(|| format!("the header at byte {} has no card {key}, which FITS requires", self.at))
    }

    fn refusal(&self, key: &str, value: i64, accepted: &str) -> String {
        let offset = self.find(key).ok().flatten().map_or(self.at, |(offset, _)| offset);
        format!("the card {key} at byte {offset} has the value {value}, where {accepted} is accepted")
    }

    fn compressed(&self, kind: HduKind) -> HduKind {
        let zimage = self.cards.iter().any(|card| card::keyword(card) == b"ZIMAGE");
        if kind == HduKind::Table && zimage { HduKind::Compressed } else { kind }
    }

    /// Bytes of data by the standard's equations 1 and 2; adds the extension's cards to
    /// `mandatory`.
    fn data_bytes(
        &self,
        kind: HduKind,
        primary: bool,
        bitpix: i64,
        axes: &[u64],
        mandatory: &mut Vec<(String, String)>,
    ) -> Result<u64, String> {
        let parameters = self.find("PCOUNT")?.map_or(0, |(_, n)| n);
        let groups = self.find("GCOUNT")?.map_or(1, |(_, n)| n);
        if groups != 1 {
            return Err(self.refusal("GCOUNT", groups, "1 (no random groups)"));
        }
        if parameters < 0 || (parameters != 0 && kind == HduKind::Image) {
            return Err(self.refusal("PCOUNT", parameters, if kind == HduKind::Image { "0" } else { "0 or more" }));
        }
        if !primary {
            mandatory.extend([("PCOUNT".into(), parameters.to_string()), ("GCOUNT".into(), "1".into())]);
        }
        if kind == HduKind::Table {
            if bitpix != 8 || axes.len() != 2 {
                return Err(format!(
                    "the table at byte {} has BITPIX {bitpix} and {} axes, where 8 and 2 are needed",
                    self.at,
                    axes.len()
                ));
            }
            let fields = self.needed("TFIELDS")?;
            if !(0..=999).contains(&fields) || (fields > 0 && axes[0] == 0 && axes[1] > 0) {
                return Err(format!(
                    "the table at byte {} has {fields} columns in rows of {} bytes: 0 to 999 columns in rows that are not empty are accepted",
                    self.at, axes[0]
                ));
            }
            mandatory.push(("TFIELDS".into(), fields.to_string()));
        }
        let elements =
            if axes.is_empty() { Some(0) } else { axes.iter().try_fold(1_u64, |n, &size| n.checked_mul(size)) };
        let elements = elements.and_then(|n| n.checked_add(parameters as u64)).unwrap_or(u64::MAX);
        if kind == HduKind::Image && elements > MAX_PIXELS {
            let sizes: Vec<_> = axes.iter().map(u64::to_string).collect();
            return Err(format!(
                "the image at byte {} has {} pixels: at most {MAX_PIXELS} are accepted",
                self.at,
                sizes.join("×")
            ));
        }
        // 2^62: the offset of the HDU and its padding can be added without overflow.
        let bytes = elements.checked_mul(bitpix.unsigned_abs() / 8).filter(|&n| n < 1 << 62);
        bytes.ok_or_else(|| format!("the header at byte {} declares more data than any file can hold", self.at))
    }
}
