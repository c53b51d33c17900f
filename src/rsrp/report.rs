//! What an import writes beside the maps: their containers, tables, the manifest.

use std::collections::BTreeMap;

use ndarray::Array1;
use serde::{Deserialize, Serialize};

use super::examine::ImportContext;
use super::map::AlignedMap;
use super::rejection::Rejection;
use crate::manifest::{
    ErrorGrids, ImportInputs, Manifest, MapEntry, MapQuality, Radio, RsrpManifest, RsrpMeta,
    Software, Solver, SolverCount, to_json,
};
use crate::store::{Digest, npy_bytes, npz_bytes};

/// Deflate level of imported maps; measured noise compresses hardly better at higher ones.
const DEFLATE_LEVEL: i64 = 1;

/// What became of a file: what the journal remembers.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) enum ImportOutcome {
    Imported { entry: Box<MapEntry>, radio: Radio },
    Rejected { file: String, location: String, rejection: Rejection },
}

impl ImportOutcome {
    /// The map, if it was taken.
    fn imported(&self) -> Option<(&MapEntry, &Radio)> {
        match self {
            Self::Imported { entry, radio } => Some((entry, radio)),
            Self::Rejected { .. } => None,
        }
    }
}

pub(super) fn rsrp_npz(meta: &RsrpMeta, map: &AlignedMap) -> Vec<u8> {
    let mut members = vec![("rsrp_dbm", npy_bytes(&map.rsrp_dbm)), ("mask", npy_bytes(&map.mask))];
    if let Some(ErrorGrids { std_error_db, first_half_share }) = &map.errors {
        members.push(("std_error_db", npy_bytes(std_error_db)));
        let half = first_half_share.as_ref();
        members.extend(half.map(|share| ("first_half_share", npy_bytes(share))));
    }
    members.push(("meta_json", npy_bytes(&Array1::from_vec(to_json(meta)))));
    npz_bytes(&members, DEFLATE_LEVEL)
}

/// One line a map that was taken: how good it is.
pub(super) fn imported_csv(outcomes: &[ImportOutcome]) -> Vec<u8> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let header = [
        "file",
        "location",
        "value_kind",
        "excess_db",
        "evidence",
        "correlation",
        "agreement",
        "lead",
        "unreached",
        "expected_rays",
        "samples_per_tx",
        "sionna_version",
        "max_depth",
        "refraction",
        "diffraction",
        "frequency_hz",
        "assumed",
        "warnings",
    ];
    // Of maps without repeats nothing more is told than ever.
    let entries = || outcomes.iter().filter_map(ImportOutcome::imported);
    let has_errors = entries().any(|(entry, _)| entry.quality.reliability.is_some());
    let of_repeats: &[&str] =
        if has_errors { &["repeats", "median_std_error_db", "unsure"] } else { &[] };
    csv.write_record(header.iter().chain(of_repeats)).expect("writing to memory cannot fail");
    let optional = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
    for (entry, radio) in entries() {
        let MapQuality { excess_db, orientation, unreached, expected_rays, reliability } =
            entry.quality;
        let warnings: Vec<_> = entry.warnings.iter().map(|warning| warning.code.name()).collect();
        let row = [
            entry.source.file.clone(),
            entry.id.to_string(),
            entry.source.value_kind.name().to_owned(),
            optional(excess_db),
            orientation.evidence.name().to_owned(),
            orientation.correlation.to_string(),
            optional(orientation.agreement),
            orientation.lead.to_string(),
            unreached.to_string(),
            expected_rays.to_string(),
            radio.samples_per_tx.to_string(),
            radio.sionna_version.clone(),
            radio.max_depth.to_string(),
            radio.refraction.to_string(),
            radio.diffraction.to_string(),
            radio.frequency_hz.to_string(),
            entry.assumed.join(" "),
            warnings.join(" "),
        ];
        let of_repeats = reliability.map_or_else(
            || [const { String::new() }; 3],
            |of| {
                [of.repeats.to_string(), of.median_std_error_db.to_string(), of.unsure.to_string()]
            },
        );
        let of_repeats = if has_errors { &of_repeats[..] } else { &[] };
        csv.write_record(row.iter().chain(of_repeats)).expect("writing to memory cannot fail");
    }
    csv.into_inner().expect("writing to memory cannot fail")
}

/// One line a map that was not taken: why, and what to do.
pub(super) fn rejected_csv(outcomes: &[ImportOutcome]) -> Vec<u8> {
    let mut csv = csv::Writer::from_writer(Vec::new());
    let header = ["file", "location", "code", "expected", "found", "mend"];
    csv.write_record(header).expect("writing to memory cannot fail");
    for outcome in outcomes {
        if let ImportOutcome::Rejected { file, location, rejection } = outcome {
            let Rejection { code, expected, found, mend } = rejection;
            csv.write_record([file, location, &code.name(), expected, found, mend])
                .expect("writing to memory cannot fail");
        }
    }
    csv.into_inner().expect("writing to memory cannot fail")
}

pub(super) fn summarise(
    outcomes: &[ImportOutcome],
    context: &ImportContext<'_>,
    fingerprint: String,
    tiles_digest: &Digest,
    inputs: ImportInputs,
) -> RsrpManifest {
    let mut maps = Vec::new();
    let mut rejected = BTreeMap::new();
    let mut solvers: Vec<SolverCount> = Vec::new();
    for outcome in outcomes {
        match outcome {
            ImportOutcome::Rejected { rejection, .. } => {
                *rejected.entry(rejection.code.name()).or_default() += 1;
            }
            ImportOutcome::Imported { entry, radio } => {
                maps.push(MapEntry::clone(entry));
                let (solver, samples) = (Solver::from(radio), radio.samples_per_tx);
                if let Some(known) = solvers.iter_mut().find(|known| known.solver == solver) {
                    let [least, most] = known.samples_per_tx;
                    known.maps += 1;
                    known.samples_per_tx = [samples.min(least), samples.max(most)];
                } else {
                    let samples_per_tx = [samples, samples];
                    solvers.push(SolverCount { solver, maps: 1, samples_per_tx });
                }
            }
        }
    }
    maps.sort_by_key(|entry| entry.id);
    RsrpManifest {
        schema: RsrpManifest::SCHEMA.to_owned(),
        fingerprint,
        software: Software::this(),
        licence: context.manifest.licence.clone(),
        attribution: context.manifest.attribution.clone(),
        epsg: context.manifest.epsg,
        config: context.rsrp.clone(),
        tiles_manifest_sha256: tiles_digest.sha256.clone(),
        solvers,
        rejected,
        inputs,
        maps,
    }
}
