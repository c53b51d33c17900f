//! Any kind of value to RSRP in dBm per resource element.

use super::metadata::{PowerReference, RadioMapMetadata};
use crate::manifest::ValueKind;
use crate::units::{Db, Dbm};

/// Transmit power of one resource element: a total is shared evenly by the subcarriers.
#[must_use]
pub(super) fn power_per_re(metadata: &RadioMapMetadata) -> Dbm {
    Dbm(metadata.tx_power_dbm) - subcarriers(metadata)
}

/// What separates the carrier's total from one resource element.
fn subcarriers(metadata: &RadioMapMetadata) -> Db {
    match (metadata.tx_power_is, metadata.n_subcarriers) {
        (PowerReference::Total, Some(count)) => Db::from_linear(count.into()),
        _ => Db(0.0),
    }
}

/// RSRP of one value, in dBm per resource element (3GPP TS 38.215, 5.1.1).
///
/// Received powers (`rss_*`) were computed with `tx_power_dbm`, so they are reduced by
/// the subcarriers where that is the total; gains and losses are applied to the power of
/// one resource element; `rsrp_dbm` is taken as it is.
#[must_use]
pub fn to_rsrp(value: f64, kind: ValueKind, metadata: &RadioMapMetadata) -> Dbm {
    match kind {
        ValueKind::PathGainLinear => power_per_re(metadata) + Db::from_linear(value),
        ValueKind::PathGainDb => power_per_re(metadata) + Db(value),
        ValueKind::PathLossDb => power_per_re(metadata) - Db(value),
        ValueKind::RssW => Dbm::from_watts(value) - subcarriers(metadata),
        ValueKind::RssDbm => Dbm(value) - subcarriers(metadata),
        ValueKind::RsrpDbm => Dbm(value),
    }
}
