//! Object stores, where this program was built with them.

#[cfg(feature = "object-store")]
pub use bucket::Bucket;
#[cfg(not(feature = "object-store"))]
pub use without::Bucket;

#[cfg(not(feature = "object-store"))]
mod without {
    use buffer::pull::{Options, Report, Watch};
    use buffer::source::Source;
    use buffer::{BufferError, Digest, Entry, Have, Name, Receive};
    use hal::Clock;

    /// There is none.
    pub enum Bucket {}

    impl Bucket {
        pub fn open(url: &str, _stall_s: u64) -> Result<Self, BufferError> {
            let text = "this program was built without object stores; build it with --features object-store";
            Err(BufferError::Usage(format!("{url}: {text}")))
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
            match *self {}
        }
    }

    impl Source for Bucket {
        fn list(&mut self) -> Result<Vec<Entry>, BufferError> {
            match *self {}
        }

        fn fetch(
            &mut self,
            _name: &Name,
            _have: Have,
            _to: &mut dyn Receive<BufferError>,
        ) -> Result<Option<Digest>, BufferError> {
            match *self {}
        }

        fn mark_pulled(&mut self, _name: &Name, _digest: &Digest) -> Result<(), BufferError> {
            match *self {}
        }
    }
}
