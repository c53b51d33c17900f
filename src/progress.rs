//! How long work reports on itself, without printing.

/// Receives the progress of a stage; called from many threads.
pub trait Progress: Sync {
    /// A phase begins; `total` steps are expected if known.
    fn begin(&self, phase: &str, total: Option<u64>);
    /// `steps` more steps of the current phase are done.
    fn advance(&self, steps: u64);
    /// The current phase is over.
    fn end(&self);
    /// How the current phase goes, in a few words that replace the ones before.
    fn state(&self, _text: &str) {}
    /// Something that a person should read, for instance a warning.
    fn note(&self, text: &str);
}

/// Ignores all reports.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _phase: &str, _total: Option<u64>) {}
    fn advance(&self, _steps: u64) {}
    fn end(&self) {}
    fn note(&self, _text: &str) {}
}
