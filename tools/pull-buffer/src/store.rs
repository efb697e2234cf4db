//! Object stores, where this program was built with them.

#[cfg(feature = "object-store")]
pub use segment_store::bucket::Bucket;
#[cfg(not(feature = "object-store"))]
pub use without::Bucket;

#[cfg(not(feature = "object-store"))]
mod without {
    use hal::Clock;
    use segment_store::pull::{Options, Progress, Report};
    use segment_store::source::Source;
    use segment_store::{Digest, Entry, FileSink, LocalCopy, Name, StoreError};

    /// Cannot be opened.
    #[allow(dead_code, reason = "there is none")]
    pub struct Bucket;

    fn without() -> StoreError {
        let text =
            "this program was built without object stores; build it with --features object-store";
        StoreError::Usage(text.to_owned())
    }

    impl Bucket {
        pub fn open(_url: &str, _stall_s: u64) -> Result<Self, StoreError> {
            Err(without())
        }

        pub fn below(self, _name: &str) -> Self {
            self
        }

        pub fn upload(
            &mut self,
            _source: &mut dyn Source,
            _options: &Options,
            _clock: &mut dyn Clock,
            _watch: &mut dyn Progress,
        ) -> Result<Report, StoreError> {
            Err(without())
        }
    }

    impl Source for Bucket {
        fn list(&mut self) -> Result<Vec<Entry>, StoreError> {
            Err(without())
        }

        fn fetch(
            &mut self,
            _name: &Name,
            _have: LocalCopy,
            _to: &mut dyn FileSink<StoreError>,
        ) -> Result<Option<Digest>, StoreError> {
            Err(without())
        }

        fn mark_pulled(&mut self, _name: &Name, _digest: &Digest) -> Result<(), StoreError> {
            Err(without())
        }
    }
}
