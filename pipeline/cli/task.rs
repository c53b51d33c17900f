//! Which part of an output a run builds.

use std::num::NonZero;

use clap::Args;
use holescout::store::{BuildMode, Part, Task};

use crate::failure::Failure;

/// Where cluster engines say which task of an array a process is, each counting from 0.
const INDEX_VARIABLES: [&str; 3] =
    ["SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX", "AWS_BATCH_JOB_ARRAY_INDEX"];
/// Where some say how many tasks the array has.
const COUNT_VARIABLES: [&str; 2] = ["SLURM_ARRAY_TASK_COUNT", "AWS_BATCH_JOB_ARRAY_SIZE"];

/// Flags of a run that is one of several.
#[derive(Debug, Args)]
#[command(next_help_heading = "Building in parts (docs/CLUSTERS.md)")]
pub(crate) struct TaskArgs {
    /// Build only what falls to this task, from 0 [default: SLURM_ARRAY_TASK_ID,
    /// JOB_COMPLETION_INDEX or AWS_BATCH_JOB_ARRAY_INDEX]
    #[arg(long, value_name = "I", requires = "task_count", conflicts_with = "merge")]
    task_index: Option<u32>,
    /// Number of tasks that fill the directory together, each a part; auto takes
    /// SLURM_ARRAY_TASK_COUNT or AWS_BATCH_JOB_ARRAY_SIZE
    #[arg(long, value_name = "N", value_parser = task_count)]
    task_count: Option<TaskCount>,
    /// Put together what the tasks have built; nothing is built, and what is missing is an error
    #[arg(long, requires = "task_count")]
    merge: bool,
}

#[derive(Debug, Clone, Copy)]
enum TaskCount {
    Auto,
    Number(NonZero<u32>),
}

fn task_count(text: &str) -> Result<TaskCount, String> {
    match text {
        "auto" => Ok(TaskCount::Auto),
        number => number.parse().map(TaskCount::Number).map_err(|_| "expected 1 or more".into()),
    }
}

impl TaskArgs {
    /// Whether this run is one of several.
    pub(super) fn is_given(&self) -> bool {
        self.task_count.is_some()
    }

    /// What to build. The environment is looked at for nothing but `--task-count`: an array job
    /// over cities must not be split by surprise.
    pub(crate) fn mode(&self, overwrite: bool) -> Result<BuildMode, Failure> {
        self.part(|name| std::env::var(name).ok())
            .and_then(|part| match part {
                Part::Whole => Ok(BuildMode { part, overwrite }),
                _ if overwrite => Err("--overwrite cannot be used with --task-count: tasks would \
                    remove each other's work; remove the directory before the first of them"
                    .to_owned()),
                _ => Ok(BuildMode { part, overwrite }),
            })
            .map_err(Failure::input)
    }

    fn part(&self, variable: impl Fn(&str) -> Option<String>) -> Result<Part, String> {
        let number = |names: &[&str], flag: &str| -> Result<u32, String> {
            let found = names.iter().find_map(|name| Some((name, variable(name)?)));
            let (name, value) = found.ok_or_else(|| {
                format!("{flag} is not given, and none of {} is set", names.join(", "))
            })?;
            value.trim().parse().map_err(|_| format!("{name} is {value:?}, expected a number"))
        };
        let count = match self.task_count {
            None => return Ok(Part::Whole),
            Some(TaskCount::Number(count)) => count.get(),
            Some(TaskCount::Auto) => number(&COUNT_VARIABLES, "--task-count N")?,
        };
        if self.merge {
            return Ok(Part::Merge { tasks: count });
        }
        let index = match self.task_index {
            Some(index) => index,
            None => number(&INDEX_VARIABLES, "--task-index")?,
        };
        if index >= count {
            return Err(format!(
                "task {index} of {count}: tasks are counted from 0 to {}, as in `sbatch --array`",
                i64::from(count) - 1
            ));
        }
        Ok(Part::Task(Task { index, count }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(count: &str, variables: &[(&str, &str)]) -> Result<Part, String> {
        let task_count = Some(task_count(count).expect("a count"));
        let args = TaskArgs { task_index: None, task_count, merge: false };
        args.part(|name| {
            let mut set = variables.iter().filter(|(set, _)| *set == name);
            set.next().map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn each_engine_tells_the_task_and_slurm_first() {
        let task = |index, count| Ok(Part::Task(Task { index, count }));
        for name in INDEX_VARIABLES {
            assert_eq!(part("4", &[(name, "3")]), task(3, 4));
        }
        let both = [("AWS_BATCH_JOB_ARRAY_INDEX", "1"), ("SLURM_ARRAY_TASK_ID", "2")];
        assert_eq!(part("4", &both), task(2, 4));
        let slurm = [("SLURM_ARRAY_TASK_ID", "2"), ("SLURM_ARRAY_TASK_COUNT", "5")];
        assert_eq!(part("auto", &slurm), task(2, 5));
    }

    #[test]
    fn what_cannot_be_a_task_is_named() {
        for (count, variables, words) in [
            ("4", &[][..], ["--task-index", "JOB_COMPLETION_INDEX"]),
            ("auto", &[("SLURM_ARRAY_TASK_ID", "1")], ["--task-count", "AWS_BATCH_JOB_ARRAY_SIZE"]),
            ("4", &[("JOB_COMPLETION_INDEX", "one")], ["JOB_COMPLETION_INDEX", "one"]),
            ("4", &[("SLURM_ARRAY_TASK_ID", "4")], ["task 4 of 4", "0 to 3"]),
        ] {
            let error = part(count, variables).expect_err("no task");
            assert!(words.iter().all(|word| error.contains(word)), "{error}");
        }
        assert!(task_count("0").is_err() && task_count("many").is_err());
    }
}
