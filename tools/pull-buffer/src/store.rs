//! Object stores, if this program was built with the feature `object-store`.

#[cfg(feature = "object-store")]
pub use segment_store::bucket::{Bucket, Keys};
#[cfg(not(feature = "object-store"))]
pub use unsupported::{Bucket, Keys};

#[cfg(not(feature = "object-store"))]
mod unsupported {
    use std::path::PathBuf;

    use hal::Clock;
    use segment_store::pull::{Options, Progress, Report};
    use segment_store::source::{Listing, Source};
    use segment_store::{Digest, FileSink, LocalCopy, Name, StoreError};

    /// A placeholder for an object store; opening one is an error.
    #[allow(dead_code, reason = "never constructed")]
    pub struct Bucket;

    /// A placeholder for the keys of encrypted segments, of which there are none.
    #[derive(Default)]
    pub struct Keys;

    fn unsupported() -> StoreError {
        let text = "this program was built without support for object stores; build it with --features object-store";
        StoreError::Usage(text.to_owned())
    }

    impl Keys {
        pub fn read(recipients: &[String], identities: &[PathBuf]) -> Result<Self, StoreError> {
            match (recipients, identities) {
                ([], []) => Ok(Self),
                _ => Err(unsupported()),
            }
        }
    }

    impl Bucket {
        pub fn open(_url: &str, _stall_s: u64) -> Result<Self, StoreError> {
            Err(unsupported())
        }

        pub fn with_subfolder(self, _name: &str) -> Self {
            self
        }

        pub fn with_keys(self, _keys: &Keys) -> Self {
            self
        }

        pub fn upload(
            &mut self,
            _source: &mut dyn Source,
            _options: &Options,
            _clock: &mut dyn Clock,
            _watch: &mut dyn Progress,
        ) -> Result<Report, StoreError> {
            Err(unsupported())
        }
    }

    impl Source for Bucket {
        fn list(&mut self) -> Result<Listing, StoreError> {
            Err(unsupported())
        }

        fn fetch(
            &mut self,
            _name: &Name,
            _local: LocalCopy,
            _to: &mut dyn FileSink<StoreError>,
        ) -> Result<Option<Digest>, StoreError> {
            Err(unsupported())
        }

        fn mark_pulled(&mut self, _name: &Name, _digest: &Digest) -> Result<(), StoreError> {
            Err(unsupported())
        }
    }
}
