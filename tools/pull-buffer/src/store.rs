//! Object stores, where this program was built with them.

#[cfg(feature = "object-store")]
pub use segment_store::bucket::Bucket;
#[cfg(not(feature = "object-store"))]
pub use without::Bucket;

#[cfg(not(feature = "object-store"))]
mod without {
    use hal::Clock;
    use segment_store::pull::{Options, Report, Watch};
    use segment_store::source::Source;
    use segment_store::{BufferError, Digest, Entry, Have, Name, Receive};

    /// Cannot be opened.
    #[allow(dead_code, reason = "there is none")]
    pub struct Bucket;

    fn without() -> BufferError {
        let text =
            "this program was built without object stores; build it with --features object-store";
        BufferError::Usage(text.to_owned())
    }

    impl Bucket {
        pub fn open(_url: &str, _stall_s: u64) -> Result<Self, BufferError> {
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
            _watch: &mut dyn Watch,
        ) -> Result<Report, BufferError> {
            Err(without())
        }
    }

    impl Source for Bucket {
        fn list(&mut self) -> Result<Vec<Entry>, BufferError> {
            Err(without())
        }

        fn fetch(
            &mut self,
            _name: &Name,
            _have: Have,
            _to: &mut dyn Receive<BufferError>,
        ) -> Result<Option<Digest>, BufferError> {
            Err(without())
        }

        fn mark_pulled(&mut self, _name: &Name, _digest: &Digest) -> Result<(), BufferError> {
            Err(without())
        }
    }
}
