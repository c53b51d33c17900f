//! Which part of an output a run builds.

/// One of several tasks that build an output together, each a part of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Task {
    /// Which one, from 0.
    pub index: u32,
    /// How many there are.
    pub count: u32,
}

impl Task {
    /// Whether an item of the plan falls to this task. They take turns, so that neighbours, which
    /// cost about the same, are shared out.
    pub(super) fn takes(self, position: usize) -> bool {
        position % self.count as usize == self.index as usize
    }
}

/// What a run builds of an output.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Part {
    /// All of it.
    #[default]
    Whole,
    /// What falls to a task. It ends without manifest.
    Task(Task),
    /// Nothing: it puts together what the tasks have built.
    Merge {
        /// How many there are.
        tasks: u32,
    },
}

/// How a run fills its directory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BuildMode {
    /// What it builds.
    pub part: Part,
    /// Replace an output of the same stage from other inputs; only a run that builds all of it
    /// may, as tasks would remove each other's work.
    pub overwrite: bool,
}

impl BuildMode {
    /// How many tasks build the output, if several do.
    pub(super) fn tasks(self) -> Option<u32> {
        match self.part {
            Part::Whole => None,
            Part::Task(task) => Some(task.count),
            Part::Merge { tasks } => Some(tasks),
        }
    }
}

/// What a task did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct TaskReport {
    /// The task.
    pub task: Task,
    /// Items of the whole plan.
    pub planned: usize,
    /// Items that fall to the task.
    pub items: usize,
    /// Of these, what an earlier run of the task had finished.
    pub found: usize,
}
