//! What `release` and `diff` are asked for.

use std::path::PathBuf;

use clap::{Args, ValueHint};
use holescout::release::{Date, Version};

#[derive(Debug, Args)]
pub(crate) struct ReleaseArgs {
    /// A dataset; of a release, its dataset is released anew
    #[arg(value_name = "DATASET", value_hint = ValueHint::DirPath)]
    pub(crate) dataset: PathBuf,
    /// Version of the data, for instance 1.2.0 (semver)
    #[arg(long, value_name = "VERSION")]
    pub(crate) version: Version,
    /// Short name: letters, digits, - _ . [default: that of the first extract]
    #[arg(long, value_name = "NAME")]
    pub(crate) name: Option<String>,
    /// Day of publication, YYYY-MM-DD [default: that of SOURCE_DATE_EPOCH, or none]
    #[arg(long, value_name = "DAY")]
    pub(crate) date: Option<Date>,
    /// Where it will be published
    #[arg(long, value_name = "URL", value_hint = ValueHint::Url)]
    pub(crate) url: Option<String>,
    /// Who made it; may be given several times
    #[arg(long, value_name = "NAME")]
    pub(crate) creator: Vec<String>,
    /// What the makers say of the data, a file of Markdown; becomes a section of the card
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub(crate) notes: Option<PathBuf>,
    /// The release before this one: a version that is too small a step from its is refused
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) previous: Option<PathBuf>,
    /// Write OUT.tar too; its files have the time of SOURCE_DATE_EPOCH, or of --date, or 0
    #[arg(long)]
    pub(crate) tar: bool,
    /// Directory to fill; it must be new, empty, or an interrupted run of the same inputs
    /// [default: NAME-VERSION beside the dataset]
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub(crate) out: Option<PathBuf>,
    /// Replace a dataset or release that was made from other inputs
    #[arg(long)]
    pub(crate) overwrite: bool,
}

#[derive(Debug, Args)]
pub(crate) struct DiffArgs {
    /// A dataset or release
    #[arg(value_name = "A", value_hint = ValueHint::DirPath)]
    pub(crate) a: PathBuf,
    /// What came after it
    #[arg(value_name = "B", value_hint = ValueHint::DirPath)]
    pub(crate) b: PathBuf,
    /// Fail if B's version is too small a step from A's; both must be releases
    #[arg(long)]
    pub(crate) check: bool,
}
