//! Features of a processor that decide which ssh cipher is the fastest.

/// The features of the processor at one end of a transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CpuFeatures {
    /// AES-GCM runs in hardware. AES is then several times as fast as ssh's first choice, which needs no hardware; without it,
    /// AES is the slower of the two.
    pub aes: bool,
}

impl CpuFeatures {
    /// Detects the features of the processor that this program runs on.
    #[must_use]
    pub fn detect() -> Self {
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
