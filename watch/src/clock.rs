//! Times: seconds since 1970 (UTC), and ISO 8601 as FITS cards have it.

use std::time::{SystemTime, UNIX_EPOCH};

/// Modified Julian date of 1970-01-01.
const MJD_1970: f64 = 40587.0;
const DAY_S: f64 = 86400.0;

/// The time now.
pub fn now_s() -> f64 {
    seconds(SystemTime::now())
}

/// Seconds since 1970 of a time of the system, negative before.
pub fn seconds(time: SystemTime) -> f64 {
    match time.duration_since(UNIX_EPOCH) {
        Ok(after) => after.as_secs_f64(),
        Err(before) => -before.duration().as_secs_f64(),
    }
}

/// Seconds since 1970 of a modified Julian date; `None` where it is none that a file of an
/// observation can have.
pub fn of_mjd(mjd: f64) -> Option<f64> {
    (mjd > 0.0 && mjd < 200_000.0).then_some((mjd - MJD_1970) * DAY_S)
}

/// Seconds since 1970 of a date with the time of the day, as FITS (`2026-11-25T04:15:30.25`) and
/// observatories write them: a blank in place of the `T`, slashes (`2026/11/25`, `25/11/2026`), no
/// separators (`20261125`), a `Z` or an offset from UTC (`-10:00`) behind the time.
pub fn of_iso(text: &str) -> Option<f64> {
    let text = text.trim();
    let (date, time) = text.split_once(['T', ' ']).unwrap_or((text, "0:0:0"));
    let (year, month, day) = date_in(date)?;
    let (time, offset_s) = without_offset(time.trim())?;
    let is_date = (1..=9999).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    is_date.then_some(days_since_1970(year, month, day) as f64 * DAY_S + time_in(time)? - offset_s)
}

/// Year, month and day of a date.
fn date_in(date: &str) -> Option<(i64, i64, i64)> {
    let date = date.trim();
    if date.len() == 8 && date.bytes().all(|byte| byte.is_ascii_digit()) {
        return Some((date[..4].parse().ok()?, date[4..6].parse().ok()?, date[6..].parse().ok()?));
    }
    let parts: Vec<&str> = date.splitn(3, ['-', '/']).collect();
    let number = |at: usize| parts.get(at)?.parse::<i64>().ok();
    let ends = (number(0)?, number(1)?, number(2)?);
    // A date with slashes may begin with its day: where the year is last it has four digits.
    if date.contains('/') && parts[2].len() == 4 {
        Some((ends.2, ends.1, ends.0))
    } else {
        (parts[0].len() >= 4).then_some(ends)
    }
}

/// A time of the day without its offset from UTC, and the offset, s.
fn without_offset(time: &str) -> Option<(&str, f64)> {
    let time = time.strip_suffix('Z').or_else(|| time.strip_suffix(" UTC")).unwrap_or(time);
    let Some(at) = time.rfind(['+', '-']) else { return Some((time, 0.0)) };
    let offset_s = time_in(&time[at + 1..])?;
    Some((&time[..at], if time[at..].starts_with('-') { -offset_s } else { offset_s }))
}

/// Seconds since midnight of a time of the day: `04:15:30.25`, `04h15m30.25s`, `04:15`, `041530`.
pub fn time_in(time: &str) -> Option<f64> {
    let time = time.trim().trim_end_matches('s');
    let is_compact = time.len() >= 6 && time.bytes().take(6).all(|byte| byte.is_ascii_digit());
    let parts: Vec<&str> =
        if is_compact { vec![&time[..2], &time[2..4], &time[4..]] } else { time.splitn(3, [':', 'h', 'm']).collect() };
    let number = |at: usize| parts.get(at)?.trim().parse::<f64>().ok();
    let seconds = if parts.len() == 3 { number(2)? } else { 0.0 };
    let (hours, minutes) = (number(0)?, number(1)?);
    let is_time = (0.0..24.0).contains(&hours) && (0.0..60.0).contains(&minutes) && (0.0..61.0).contains(&seconds);
    is_time.then_some(hours * 3600.0 + minutes * 60.0 + seconds)
}

/// `2026-11-25T04:15:30.250Z`.
pub fn to_iso(seconds: f64) -> String {
    if !seconds.is_finite() || seconds.abs() > 1e11 {
        return "unknown".into();
    }
    let milliseconds = (seconds * 1e3).round() as i64;
    let (days, rest) = (milliseconds.div_euclid(86_400_000), milliseconds.rem_euclid(86_400_000));
    let (year, month, day) = date_of(days);
    let (hours, minutes, seconds) = (rest / 3_600_000, rest / 60_000 % 60, rest % 60_000);
    format!("{year:04}-{month:02}-{day:02}T{hours:02}:{minutes:02}:{:02}.{:03}Z", seconds / 1000, seconds % 1000)
}

/// Days from 1970-01-01 to a date of the Gregorian calendar: years begin in March, so that a leap
/// day is the last, and 400 of them have 146,097 days (H. Hinnant, "chrono-compatible low-level
/// date algorithms").
fn days_since_1970(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let era = year.div_euclid(400);
    let year_of_era = year.rem_euclid(400);
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    era * 146_097 + year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year - 719_468
}

/// The inverse of [`days_since_1970`].
fn date_of(days: i64) -> (i64, i64, i64) {
    let days = days + 719_468;
    let (era, day_of_era) = (days.div_euclid(146_097), days.rem_euclid(146_097));
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * day_of_year + 2) / 153;
    let (day, month) =
        (day_of_year - (153 * shifted + 2) / 5 + 1, if shifted < 10 { shifted + 3 } else { shifted - 9 });
    (year_of_era + era * 400 + i64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_read_and_written() {
        for (text, seconds) in [
            ("1970-01-01T00:00:00", 0.0),
            ("2000-02-29T12:00:00.5", 951_825_600.5),
            ("2026-11-25T04:15:30.250Z", 1_795_580_130.25),
            ("1969-12-31", -86400.0),
        ] {
            assert_eq!(of_iso(text), Some(seconds), "{text}");
            assert_eq!(of_iso(&to_iso(seconds)), Some(seconds), "{text}");
        }
        for text in [
            "2026-11-25 04:15:30.25",
            "2026/11/25T04:15:30.25",
            "25/11/2026 04h15m30.25s",
            "20261125T041530.25",
            "2026-11-24T18:15:30.25-10:00",
            "2026-11-25T04:15:30.25 UTC",
        ] {
            assert_eq!(of_iso(text), Some(1_795_580_130.25), "{text}");
        }
        for text in ["", "yesterday", "2026-13-01T00:00:00", "2026-11-25T25:00:00", "25/11/26", "2026-11-25T04:15:99"] {
            assert_eq!(of_iso(text), None, "{text}");
        }
        assert_eq!(of_mjd(40587.5), Some(43200.0));
        assert_eq!(to_iso(f64::NAN), "unknown");
    }
}
