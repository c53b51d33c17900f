//! Which step of a version a change asks for.
//!
//! As Croissant 1.1 has it ("Version"): PATCH while the data remain the same, MINOR while those
//! that were there remain, MAJOR otherwise. Before 1.0.0 a breaking change raises the second
//! number and everything else the third, as Cargo has it.

use semver::Version;
use serde::Serialize;

/// How far a version has to go.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum VersionStep {
    /// Nothing changed.
    None,
    /// Texts, compression or the order of bytes changed: the data are the same.
    Patch,
    /// Something was added: what was there is the same.
    Minor,
    /// A reader or a result of the old one may break.
    Major,
}

impl VersionStep {
    /// Its name, for people.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Patch => "patch",
            Self::Minor => "minor",
            Self::Major => "major",
        }
    }
}

/// The lowest version that may follow a change. A pre-release may change anything on the way to
/// the version that it precedes.
#[must_use]
pub fn least(from: &Version, step: VersionStep) -> Version {
    let Version { major, minor, patch, .. } = *from;
    match (step, major) {
        (VersionStep::Patch | VersionStep::Minor | VersionStep::Major, _)
            if !from.pre.is_empty() =>
        {
            Version::new(major, minor, patch)
        }
        (VersionStep::None, _) => from.clone(),
        (VersionStep::Major, 1..) => Version::new(major + 1, 0, 0),
        (VersionStep::Major, 0) | (VersionStep::Minor, 1..) => Version::new(major, minor + 1, 0),
        (VersionStep::Minor, 0) | (VersionStep::Patch, _) => Version::new(major, minor, patch + 1),
    }
}

/// Whether a version is as far from another as a change asks for. A pre-release counts as the
/// version that it precedes.
#[must_use]
pub fn is_enough(from: &Version, to: &Version, step: VersionStep) -> bool {
    let core = |version: &Version| (version.major, version.minor, version.patch);
    let moves = step == VersionStep::None || to > from;
    moves && core(to) >= core(&least(from, step))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn enough(from: &str, to: &str, step: VersionStep) -> bool {
        let parse = |text: &str| text.parse::<Version>().expect("a version");
        is_enough(&parse(from), &parse(to), step)
    }

    #[test]
    fn every_step_has_its_least_version() {
        let cases = [
            ("1.2.3", VersionStep::None, "1.2.3"),
            ("1.2.3", VersionStep::Patch, "1.2.4"),
            ("1.2.3", VersionStep::Minor, "1.3.0"),
            ("1.2.3", VersionStep::Major, "2.0.0"),
            ("0.2.3", VersionStep::Patch, "0.2.4"),
            ("0.2.3", VersionStep::Minor, "0.2.4"),
            ("0.2.3", VersionStep::Major, "0.3.0"),
        ];
        for (from, step, to) in cases {
            let found = least(&from.parse().expect("a version"), step);
            assert_eq!(found.to_string(), to, "{from} {step:?}");
            assert!(enough(from, to, step));
        }
    }

    #[test]
    fn too_small_a_step_and_one_back_are_not_enough() {
        assert!(!enough("1.1.0", "1.2.0", VersionStep::Major));
        assert!(!enough("1.1.0", "1.1.1", VersionStep::Minor));
        assert!(!enough("1.1.0", "1.1.0", VersionStep::Patch));
        assert!(enough("1.1.0", "1.1.0", VersionStep::None));
        assert!(!enough("2.0.0", "1.9.9", VersionStep::None));
        assert!(enough("1.1.0", "3.0.0", VersionStep::Patch));
    }

    #[test]
    fn pre_releases_lead_to_their_version() {
        assert!(enough("1.1.0", "2.0.0-rc.1", VersionStep::Major));
        for step in [VersionStep::Patch, VersionStep::Minor, VersionStep::Major] {
            assert!(enough("2.0.0-rc.1", "2.0.0-rc.2", step), "{step:?}");
            assert!(enough("2.0.0-rc.1", "2.0.0", step), "{step:?}");
            assert!(!enough("2.0.0-rc.2", "2.0.0-rc.1", step), "{step:?}");
            assert!(!enough("2.0.0-rc.1", "2.0.0-rc.1", step), "{step:?}");
            assert!(!enough("2.0.0-rc.1", "1.9.0", step), "{step:?}");
        }
        assert!(!enough("2.0.0", "2.0.1-rc.1", VersionStep::Major));
    }
}
