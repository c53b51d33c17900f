//! What all manifests share.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use schemars::generate::SchemaSettings;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::error::{Fault, FileError, HasFault};
use crate::store::{Digest, MANIFEST, sha256_bytes};

/// Why a manifest cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ManifestError {
    /// There is none: the directory is unfinished, or something else.
    #[error(
        "{}: no {MANIFEST}: not an output of `holescout {stage}`, or its run was interrupted; \
         run it again", directory.display()
    )]
    Absent {
        /// The directory.
        directory: PathBuf,
        /// The command that writes such manifests.
        stage: &'static str,
    },
    /// It cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// It is not what was expected.
    #[error("{}: {reason}; expected the output of `holescout {stage}`", path.display())]
    Invalid {
        /// The manifest.
        path: PathBuf,
        /// What is wrong.
        reason: String,
        /// The command that writes such manifests.
        stage: &'static str,
    },
}

impl HasFault for ManifestError {
    fn fault(&self) -> Fault {
        match self {
            Self::File(error) => error.fault(),
            Self::Absent { .. } | Self::Invalid { .. } => Fault::Input,
        }
    }
}

/// The program that wrote an output.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Software {
    /// Name of the program.
    pub name: String,
    /// Its version (semver).
    pub version: String,
}

impl Software {
    /// This program.
    #[must_use]
    pub fn this() -> Self {
        Self {
            name: env!("CARGO_PKG_NAME").to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }
}

/// An input file, named by its content.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Input {
    /// File name without directories.
    pub file: String,
    /// Size and SHA-256.
    pub digest: Digest,
    /// Licence, as an SPDX identifier.
    pub licence: String,
    /// The attribution that the licence asks for.
    pub attribution: String,
}

/// The SHA-256 over everything that an output depends on, this program's version included.
#[must_use]
pub fn fingerprint(depends_on: &impl Serialize) -> String {
    let everything = (Software::this(), depends_on);
    sha256_bytes(&to_json(&everything)).sha256
}

/// Indented JSON with a newline at the end.
///
/// # Panics
/// Never for the types of this crate: their keys are strings.
#[must_use]
pub fn to_json(value: &impl Serialize) -> Vec<u8> {
    let mut bytes = serde_json::to_vec_pretty(value).expect("keys are strings");
    bytes.push(b'\n');
    bytes
}

/// The JSON Schema (draft 2020-12) of a type, as `schemas/` holds it.
#[must_use]
pub fn json_schema<T: JsonSchema>() -> Vec<u8> {
    json_schema_with::<T>(|_| ())
}

/// As [`json_schema`], of a type whose schema is told more exactly than its declaration can.
pub(crate) fn json_schema_with<T: JsonSchema>(
    change: impl FnOnce(&mut serde_json::Map<String, serde_json::Value>),
) -> Vec<u8> {
    let generator = SchemaSettings::draft2020_12().into_generator();
    let mut schema = generator.into_root_schema_for::<T>();
    change(schema.ensure_object());
    to_json(&schema)
}

/// The schema of a directory's manifest, if it has one.
#[must_use]
pub fn schema(directory: &Path) -> Option<String> {
    let text = std::fs::read(directory.join(MANIFEST)).ok()?;
    let value: serde_json::Value = serde_json::from_slice(&text).ok()?;
    Some(value.get("schema")?.as_str()?.to_owned())
}

/// What a stage writes last, and with it vouches for its output.
pub trait Manifest: DeserializeOwned {
    /// The value of `schema`.
    const SCHEMA: &'static str;
    /// The command that writes it.
    const COMMAND: &'static str;
}

/// Reads a directory's manifest, with its digest.
///
/// # Errors
/// [`ManifestError`]; an unknown field or another schema is an error.
pub fn load<M: Manifest>(directory: &Path) -> Result<(M, Digest), ManifestError> {
    let stage = M::COMMAND;
    let path = directory.join(MANIFEST);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Err(ManifestError::Absent { directory: directory.to_owned(), stage });
        }
        Err(error) => return Err(FileError::new("read", &path)(error).into()),
    };
    Ok((parse(&bytes, &path)?, sha256_bytes(&bytes)))
}

/// Reads a manifest that was found at `path`.
///
/// # Errors
/// As [`load`].
pub fn parse<M: Manifest>(bytes: &[u8], path: &Path) -> Result<M, ManifestError> {
    let (stage, schema) = (M::COMMAND, M::SCHEMA);
    let invalid = |reason: String| ManifestError::Invalid { path: path.to_owned(), reason, stage };
    let value: serde_json::Value =
        serde_json::from_slice(bytes).map_err(|error| invalid(format!("no JSON: {error}")))?;
    let found = value.get("schema").and_then(serde_json::Value::as_str).unwrap_or("none");
    if found != schema {
        return Err(invalid(format!("schema is {found:?}, not {schema:?}")));
    }
    serde_json::from_value(value).map_err(|error| invalid(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn manifests_of_other_stages_and_missing_ones_are_told_apart() {
        let dir = tempfile::tempdir().expect("a directory");
        let load_it = || load::<crate::manifest::TilesManifest>(dir.path());
        assert!(matches!(load_it(), Err(ManifestError::Absent { .. })));
        std::fs::write(dir.path().join(MANIFEST), r#"{"schema": "rsrp.v1"}"#).expect("written");
        let error = load_it().expect_err("another schema");
        assert!(error.to_string().contains("rsrp.v1"), "{error}");
    }

    #[test]
    fn fingerprints_depend_on_content() {
        assert_eq!(fingerprint(&("a", 1)), fingerprint(&("a", 1)));
        assert_ne!(fingerprint(&("a", 1)), fingerprint(&("a", 2)));
    }
}
