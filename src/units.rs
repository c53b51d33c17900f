//! Units that are easily confused, as types.
//!
//! Only quantities that people do mix up are wrapped: a power level in dBm is not
//! a ratio in dB. Lengths are metres everywhere and carry `_m` in their names.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A power level relative to one milliwatt, in dBm.
///
/// Reference-signal received power (RSRP) is the power per resource element
/// (3GPP TS 38.215, section 5.1.1).
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct Dbm(pub f64);

/// A power ratio in decibels, for instance a path gain.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct Db(pub f64);

impl Db {
    /// `10 log10(ratio)`; `ratio` is linear and positive, 0 gives negative infinity.
    #[must_use]
    pub fn from_linear(ratio: f64) -> Self {
        Self(10.0 * libm::log10(ratio))
    }

    /// `10^(dB / 10)`.
    #[must_use]
    pub fn to_linear(self) -> f64 {
        libm::exp10(self.0 / 10.0)
    }
}

impl Dbm {
    /// The level of a power in watts.
    #[must_use]
    pub fn from_watts(watts: f64) -> Self {
        Self(Db::from_linear(watts).0 + 30.0)
    }

    /// The power in milliwatts.
    #[must_use]
    pub fn to_milliwatts(self) -> f64 {
        Db(self.0).to_linear()
    }

    /// The level of a power in milliwatts.
    #[must_use]
    pub fn from_milliwatts(milliwatts: f64) -> Self {
        Self(Db::from_linear(milliwatts).0)
    }
}

impl std::ops::Add<Db> for Dbm {
    type Output = Self;
    fn add(self, gain: Db) -> Self {
        Self(self.0 + gain.0)
    }
}

impl std::ops::Sub<Db> for Dbm {
    type Output = Self;
    fn sub(self, loss: Db) -> Self {
        Self(self.0 - loss.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_watt_is_30_dbm_and_minus_100_db_of_it_minus_70() {
        assert!((Dbm::from_watts(1.0).0 - 30.0).abs() < 1e-12);
        assert!(((Dbm::from_watts(1.0) + Db(-100.0)).0 + 70.0).abs() < 1e-12);
        assert!((Dbm(-90.0).to_milliwatts() - 1e-9).abs() < 1e-21);
        assert_eq!(Db::from_linear(0.0).0, f64::NEG_INFINITY);
    }
}
