//! Threads for the core's work, in a process that was forked too.

use pyo3::marker::Ungil;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::process;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// The process that loaded this module.
static HOME: OnceLock<u32> = OnceLock::new();

/// Threads of a process that was forked from it, and that process. A fork has none of its parent's threads: work that is
/// given to them would wait for ever.
static FORKED: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// Remember the process.
pub fn settle() {
    HOME.get_or_init(process::id);
}

/// Work with the interpreter's lock released.
pub fn detached<R: Ungil + Send>(py: Python<'_>, work: impl FnOnce() -> R + Ungil + Send) -> R {
    match forked() {
        None => py.detach(work),
        Some(pool) => py.detach(|| pool.install(work)),
    }
}

/// This process's own threads, if it was forked; none where they cannot be had, and for the first process.
fn forked() -> Option<Arc<ThreadPool>> {
    let own = process::id();
    if HOME.get() == Some(&own) {
        return None;
    }
    let mut made = FORKED.lock().unwrap_or_else(PoisonError::into_inner);
    if made.as_ref().is_none_or(|(process, _)| *process != own) {
        *made = Some((own, Arc::new(ThreadPoolBuilder::new().build().ok()?)));
    }
    made.as_ref().map(|(_, pool)| pool.clone())
}
