//! Serves a directory on stdin and stdout as `firmware-host buffer serve DIR` does, so that tests of this package need not
//! build that program. `--without-aes` in front: on a computer that has none.

use std::io::{BufWriter, Write};

fn main() {
    let dir = std::env::args().next_back().unwrap_or_default();
    let root = segment_store::Root::open(dir.as_ref()).unwrap_or_else(|error| {
        eprintln!("error: {error}");
        std::process::exit(1);
    });
    let mut output = BufWriter::new(std::io::stdout().lock());
    // A workstation that was killed is no error of this side.
    let computer = segment_store::CpuFeatures {
        aes: !std::env::args().any(|argument| argument == "--without-aes"),
    };
    let _ = segment_store::serve(&root, computer, &mut std::io::stdin().lock(), &mut output)
        .and_then(|()| output.flush());
}
