//! Something that is wrong.

/// Something that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub struct VerifyFailure {
    /// The file, relative to the directory.
    pub file: String,
    /// The record in it, if a single one is to blame.
    pub record: Option<String>,
    /// What is wrong: expected and found.
    pub reason: String,
}

impl std::fmt::Display for VerifyFailure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.record {
            Some(record) => write!(f, "{}: {record}: {}", self.file, self.reason),
            None => write!(f, "{}: {}", self.file, self.reason),
        }
    }
}

pub(super) fn failure(file: &str, reason: impl Into<String>) -> VerifyFailure {
    VerifyFailure { file: file.to_owned(), record: None, reason: reason.into() }
}

pub(super) fn demand(holds: Result<bool, String>, otherwise: &str) -> Result<(), String> {
    if holds? { Ok(()) } else { Err(otherwise.to_owned()) }
}
