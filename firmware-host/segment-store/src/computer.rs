//! What the other side of a transfer should know about this computer.

/// A computer at one end of a transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Computer {
    /// Encrypts with AES-GCM in hardware: several times as fast as with ssh's first choice, which needs none. Without it AES is
    /// the slower one.
    pub aes: bool,
}

impl Computer {
    /// The one that this program runs on.
    #[must_use]
    pub fn this() -> Self {
        #[cfg(target_arch = "x86_64")]
        let aes = is_x86_feature_detected!("aes") && is_x86_feature_detected!("pclmulqdq");
        #[cfg(target_arch = "aarch64")]
        let aes = std::arch::is_aarch64_feature_detected!("aes")
            && std::arch::is_aarch64_feature_detected!("pmull");
        #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
        let aes = false;
        Self { aes }
    }
}
