//! Back ends and their choice at run time, so that one portable binary is as fast as a native build.

use crate::error::Error;
use std::sync::OnceLock;

/// A back end: the instruction set that the kernels run with. Values come from detection only: where one exists, the
/// processor can execute its instructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Backend(pub(crate) Kind);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    #[cfg(target_arch = "x86_64")]
    Avx512,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "aarch64")]
    Neon,
    Portable,
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
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            if avx2 && is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq") {
                found.push(Backend(Kind::Avx512));
            }
            if avx2 {
                found.push(Backend(Kind::Avx2));
            }
        }
        #[cfg(target_arch = "aarch64")]
        found.push(Backend(Kind::Neon));
        found.push(Backend(Kind::Portable));
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
            Kind::Avx512 => "avx512",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            #[cfg(target_arch = "aarch64")]
            Kind::Neon => "neon",
            Kind::Portable => "portable",
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

/// Compile `$generic::<Lane>` once per back end, and choose between the instances at run time. `$generic` and
/// everything it calls must be `inline(always)`, so that they are compiled with the instance's instructions.
macro_rules! dispatched {
    ($(#[$doc:meta])* $visibility:vis unsafe fn $name:ident = $generic:ident($($arg:ident: $kind:ty),* $(,)?)) => {
        $(#[$doc])*
        #[allow(clippy::too_many_arguments)]
        $visibility unsafe fn $name(backend: $crate::simd::dispatch::Backend, $($arg: $kind),*) {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
            #[allow(clippy::too_many_arguments)]
            unsafe fn avx512($($arg: $kind),*) {
                // SAFETY: the caller's promise, passed on.
                unsafe { $generic::<$crate::simd::x86::Avx512>($($arg),*) }
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            #[allow(clippy::too_many_arguments)]
            unsafe fn avx2($($arg: $kind),*) {
                // SAFETY: the caller's promise, passed on.
                unsafe { $generic::<$crate::simd::x86::Avx2>($($arg),*) }
            }
            // SAFETY: a `Backend` value exists only where its instructions were detected; the other conditions are the
            // caller's promise.
            unsafe {
                match backend.0 {
                    #[cfg(target_arch = "x86_64")]
                    $crate::simd::dispatch::Kind::Avx512 => avx512($($arg),*),
                    #[cfg(target_arch = "x86_64")]
                    $crate::simd::dispatch::Kind::Avx2 => avx2($($arg),*),
                    #[cfg(target_arch = "aarch64")]
                    $crate::simd::dispatch::Kind::Neon => $generic::<$crate::simd::portable::Portable<true>>($($arg),*),
                    $crate::simd::dispatch::Kind::Portable => $generic::<$crate::simd::portable::Portable<false>>($($arg),*),
                }
            }
        }
    };
}
pub(crate) use dispatched;
