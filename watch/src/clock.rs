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

/// Seconds since 1970 of a modified Julian date; `None` where it is none that a file of an observation can have.
pub fn of_mjd(mjd: f64) -> Option<f64> {
    (mjd > 0.0 && mjd < 200_000.0).then_some((mjd - MJD_1970) * DAY_S)
}

/// Seconds since 1970 of `2026-11-25T04:15:30.25` or `2026-11-25`; a `Z` may follow.
pub fn of_iso(text: &str) -> Option<f64> {
    let text = text.trim().trim_end_matches('Z');
    let (date, time) = text.split_once(['T', ' ']).unwrap_or((text, "0:0:0"));
    let mut parts = date.splitn(3, '-').map(|part| part.parse::<i64>().ok());
    let (year, month, day) = (parts.next()??, parts.next()??, parts.next()??);
    let mut clock = time.splitn(3, ':').map(|part| part.parse::<f64>().ok());
    let (hours, minutes, seconds) = (clock.next()??, clock.next()??, clock.next().unwrap_or(Some(0.0))?);
    let is_date = (1..=9999).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    let is_time = (0.0..24.0).contains(&hours) && (0.0..60.0).contains(&minutes) && (0.0..61.0).contains(&seconds);
    (is_date && is_time)
        .then(|| days_since_1970(year, month, day) as f64 * DAY_S + hours * 3600.0 + minutes * 60.0 + seconds)
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

/// Days from 1970-01-01 to a date of the Gregorian calendar: years begin in March, so that a leap day is the last, and 400 of them
/// have 146,097 days (H. Hinnant, "chrono-compatible low-level date algorithms").
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
        for text in ["", "yesterday", "2026-13-01T00:00:00", "2026-11-25T25:00:00", "25/11/26", "2026-11-25T04:15:99"] {
            assert_eq!(of_iso(text), None, "{text}");
        }
        assert_eq!(of_mjd(40587.5), Some(43200.0));
        assert_eq!(to_iso(f64::NAN), "unknown");
    }
}
