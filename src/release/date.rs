//! Days of publication. They are given, never taken from a clock: the same command must give the
//! same bytes tomorrow.

use std::fmt;
use std::str::FromStr;

const SECONDS_OF_A_DAY: u64 = 86_400;
const MONTHS: [u64; 12] = [31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];

/// A day of the Gregorian calendar from 1970-01-01 on, in UTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Date {
    year: u64,
    month: u64,
    day: u64,
}

/// A text that is no day.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no day from 1970 to 9999, expected for instance 2026-07-01")]
pub struct DateError(String);

impl Date {
    /// The day of a number of seconds since 1970, as `SOURCE_DATE_EPOCH` has it; `None` after 9999.
    #[must_use]
    pub fn of_epoch(seconds: u64) -> Option<Self> {
        let mut days = seconds / SECONDS_OF_A_DAY;
        let year = (1970..=9999).find(|&year| take(&mut days, days_of_year(year)))?;
        let month = (1..=12).find(|&month| take(&mut days, days_of_month(year, month)))?;
        Some(Self { year, month, day: days + 1 })
    }

    /// Seconds from 1970 to the beginning of the day.
    #[must_use]
    pub fn epoch(self) -> u64 {
        let years: u64 = (1970..self.year).map(days_of_year).sum();
        let months: u64 = (1..self.month).map(|month| days_of_month(self.year, month)).sum();
        (years + months + self.day - 1) * SECONDS_OF_A_DAY
    }
}

/// Takes a year or month off the days, unless they end in it.
fn take(days: &mut u64, length: u64) -> bool {
    if *days >= length {
        *days -= length;
        return false;
    }
    true
}

fn is_leap(year: u64) -> bool {
    year.is_multiple_of(4) && !year.is_multiple_of(100) || year.is_multiple_of(400)
}

fn days_of_year(year: u64) -> u64 {
    365 + u64::from(is_leap(year))
}

fn days_of_month(year: u64, month: u64) -> u64 {
    MONTHS[month as usize - 1] + u64::from(month == 2 && is_leap(year))
}

impl fmt::Display for Date {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:04}-{:02}-{:02}", self.year, self.month, self.day)
    }
}

impl FromStr for Date {
    type Err = DateError;

    fn from_str(text: &str) -> Result<Self, DateError> {
        let parse = || {
            let mut parts = text.split('-').map(|part| part.parse::<u64>().ok());
            let (year, month, day) = (parts.next()??, parts.next()??, parts.next()??);
            let is_day = (1970..=9999).contains(&year)
                && (1..=12).contains(&month)
                && (1..=days_of_month(year, month)).contains(&day);
            let date = Self { year, month, day };
            // Only the canonical spelling.
            (is_day && date.to_string() == text).then_some(date)
        };
        parse().ok_or_else(|| DateError(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_those_of_the_calendar() {
        let cases = [
            (0, "1970-01-01"),
            (951_782_400, "2000-02-29"),
            (1_709_251_199, "2024-02-29"),
            (1_709_251_200, "2024-03-01"),
            (4_107_542_400, "2100-03-01"),
            (253_402_300_799, "9999-12-31"),
        ];
        for (seconds, text) in cases {
            let date = Date::of_epoch(seconds).expect("a day");
            assert_eq!(date.to_string(), text);
            assert_eq!(text.parse(), Ok(date));
            assert_eq!(date.epoch(), seconds / SECONDS_OF_A_DAY * SECONDS_OF_A_DAY);
        }
        assert_eq!(Date::of_epoch(253_402_300_800), None);
    }

    #[test]
    fn other_texts_are_no_days() {
        for text in ["", "2026", "2026-7-1", "2026-02-29", "1969-12-31", "2026-13-01", "1/7/2026"] {
            assert_eq!(text.parse::<Date>(), Err(DateError(text.to_owned())));
        }
    }
}
