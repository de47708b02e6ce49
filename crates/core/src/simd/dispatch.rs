//! Back ends and their choice at run time, so that one portable binary is as fast as a native build.

use crate::error::Error;
use crate::simd::portable::Portable;
use crate::simd::token::Simd;
#[cfg(target_arch = "x86_64")]
use crate::simd::x86::{Avx2, Avx512};
use std::fmt;
use std::sync::OnceLock;

/// A back end: the instruction set that the kernels run with. Values come from detection only: where one exists, the
/// processor can execute its instructions.
#[derive(Clone, Copy)]
pub struct Backend(pub(crate) Kind);

/// The token of the back end, which proves its instructions.
#[derive(Clone, Copy)]
pub(crate) enum Kind {
    #[cfg(target_arch = "x86_64")]
    Avx512(Simd<Avx512>),
    #[cfg(target_arch = "x86_64")]
    Avx2(Simd<Avx2>),
    #[cfg(target_arch = "aarch64")]
    Neon(Simd<Portable<true>>),
    Portable(Simd<Portable<false>>),
}

impl PartialEq for Backend {
    fn eq(&self, other: &Backend) -> bool {
        self.name() == other.name()
    }
}

impl Eq for Backend {}

impl fmt::Debug for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Backend").field(&self.name()).finish()
    }
}

impl Backend {
    /// Every back end that this machine can run, fastest first.
    ///
    /// # Example
    ///
    /// ```
    /// use haptid_core::Backend;
    /// assert!(Backend::available().contains(&Backend::best()));
    /// ```
    pub fn available() -> Vec<Backend> {
        let mut found = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            found.extend(Simd::<Avx512>::detect().map(|simd| Backend(Kind::Avx512(simd))));
            found.extend(Simd::<Avx2>::detect().map(|simd| Backend(Kind::Avx2(simd))));
        }
        #[cfg(target_arch = "aarch64")]
        found.push(Backend(Kind::Neon(Simd::portable())));
        found.push(Backend(Kind::Portable(Simd::portable())));
        found
    }

    /// The fastest back end of this machine.
    ///
    /// # Example
    ///
    /// ```
    /// println!("{}", haptid_core::Backend::best().name());
    /// ```
    pub fn best() -> Backend {
        static BEST: OnceLock<Backend> = OnceLock::new();
        *BEST.get_or_init(|| Backend::available()[0])
    }

    /// The back end that the environment variable `HAPTID_BACKEND` names, read once; the fastest one if it is not set.
    /// Errors with [`Error::Backend`] if the machine does not have it.
    ///
    /// # Example
    ///
    /// ```
    /// // HAPTID_BACKEND=portable in the environment makes this the portable back end.
    /// let backend = haptid_core::Backend::selected()?;
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn selected() -> Result<Backend, Error> {
        static SELECTED: OnceLock<Result<Backend, Error>> = OnceLock::new();
        let selected = SELECTED.get_or_init(|| match std::env::var_os("HAPTID_BACKEND") {
            Some(name) => Backend::named(&name.to_string_lossy()),
            None => Ok(Backend::best()),
        });
        selected.clone()
    }

    /// Name of the back end: `avx512`, `avx2`, `neon` or `portable`.
    ///
    /// # Example
    ///
    /// ```
    /// assert_eq!(haptid_core::Backend::named("portable")?.name(), "portable");
    /// # Ok::<(), haptid_core::Error>(())
    /// ```
    pub fn name(self) -> &'static str {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512(_) => "avx512",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2(_) => "avx2",
            #[cfg(target_arch = "aarch64")]
            Kind::Neon(_) => "neon",
            Kind::Portable(_) => "portable",
        }
    }

    /// The back end of this name. Errors with [`Error::Backend`] if the machine does not have it.
    ///
    /// # Example
    ///
    /// ```
    /// use haptid_core::Backend;
    /// assert!(Backend::named("portable").is_ok() && Backend::named("abacus").is_err());
    /// ```
    pub fn named(name: &str) -> Result<Backend, Error> {
        let found = Backend::available().into_iter().find(|b| b.name() == name);
        found.ok_or_else(|| Error::Backend { name: name.to_owned() })
    }
}

/// Compile `$generic` once per back end, and choose between the instances at run time: each takes its token first, then
/// the arguments. `$generic` and everything it calls must be `inline(always)`, so that they are compiled with the
/// instance's instructions. What is unsafe is so for reasons of its own: the instructions are proved by the tokens.
macro_rules! dispatched {
    ($(#[$doc:meta])* $visibility:vis unsafe fn $name:ident = $generic:ident($($arg:ident: $kind:ty),* $(,)?)) => {
        $(#[$doc])*
        #[allow(clippy::too_many_arguments)]
        $visibility unsafe fn $name(backend: $crate::simd::dispatch::Backend, $($arg: $kind),*) {
            // SAFETY: the caller's promise, passed on.
            $crate::simd::dispatch::choose!(backend, simd => unsafe { $generic(simd, $($arg),*) })
        }
    };
    ($(#[$doc:meta])* $visibility:vis fn $name:ident = $generic:ident($($arg:ident: $kind:ty),* $(,)?)) => {
        $(#[$doc])*
        $visibility fn $name(backend: $crate::simd::dispatch::Backend, $($arg: $kind),*) {
            $crate::simd::dispatch::choose!(backend, simd => $generic(simd, $($arg),*))
        }
    };
}

/// Evaluate an expression with the back end's token, compiled with its instructions.
macro_rules! choose {
    ($backend:expr, $simd:ident => $body:expr) => {
        match $backend.0 {
            #[cfg(target_arch = "x86_64")]
            $crate::simd::dispatch::Kind::Avx512($simd) => $simd.run(
                #[inline(always)]
                || $body,
            ),
            #[cfg(target_arch = "x86_64")]
            $crate::simd::dispatch::Kind::Avx2($simd) => $simd.run(
                #[inline(always)]
                || $body,
            ),
            #[cfg(target_arch = "aarch64")]
            $crate::simd::dispatch::Kind::Neon($simd) => $body,
            $crate::simd::dispatch::Kind::Portable($simd) => $body,
        }
    };
}
pub(crate) use {choose, dispatched};
