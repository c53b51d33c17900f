//! Errors on their way to the exit code.

use std::error::Error;
use std::fmt;
use std::process::ExitCode;

use holescout::error::{Fault, HasFault};

/// What tells the engine of a cluster that trying again cannot help. It is unlike what shells,
/// signals and panics make of an exit.
pub(crate) const PERMANENT: u8 = 42;

/// An error and whose fault it is.
#[derive(Debug)]
pub(crate) struct Failure {
    fault: Fault,
    error: Box<dyn Error + Send + Sync>,
}

impl Failure {
    /// The machine failed.
    pub(crate) fn running(error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self { fault: Fault::Running, error: error.into() }
    }

    /// The input is wrong.
    pub(crate) fn input(error: impl Into<Box<dyn Error + Send + Sync>>) -> Self {
        Self { fault: Fault::Input, error: error.into() }
    }

    /// 1 for a failure while running, 3 for invalid input; clap itself exits with 2. One of
    /// several tasks says [`PERMANENT`] instead of the latter two.
    pub(crate) fn exit_code(&self, is_task: bool) -> ExitCode {
        match self.fault {
            Fault::Running => ExitCode::from(1),
            Fault::Input if is_task => ExitCode::from(PERMANENT),
            Fault::Input => ExitCode::from(3),
        }
    }

    /// Whether the reader of standard output has left, which is no failure.
    pub(crate) fn is_broken_pipe(&self) -> bool {
        let io = self.error.downcast_ref::<std::io::Error>();
        io.is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
    }
}

impl<E: HasFault + Send + Sync + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        Self { fault: error.fault(), error: Box::new(error) }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.error.fmt(f)
    }
}
