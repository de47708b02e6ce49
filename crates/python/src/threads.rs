//! Threads for the core's work, also in forked processes.

use pyo3::marker::Ungil;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::process;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// The process that loaded this module.
static HOME: OnceLock<u32> = OnceLock::new();

/// Thread pool of a forked process, and that process. A fork has none of its parent's threads: work passed to its
/// parent's pool would wait for ever.
static FORKED: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// Record the process that loads this module.
pub fn remember_process() {
    HOME.get_or_init(process::id);
}

/// Run `work` with the interpreter's lock released.
pub fn detached<R: Ungil + Send>(py: Python<'_>, work: impl FnOnce() -> R + Ungil + Send) -> R {
    match forked() {
        None => py.detach(work),
        Some(pool) => py.detach(|| pool.install(work)),
    }
}

/// The pool of this process, if it was forked; `None` for the process that loaded the module, and where no pool can be
/// made.
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
