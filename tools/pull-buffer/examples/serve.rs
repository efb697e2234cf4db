//! Serves a directory on standard input and output like `firmware-host buffer serve DIR`, so that the tests of this package need
//! not build that program. With `--without-aes` it reports a processor without AES.

use std::io::{BufWriter, Write};

fn main() {
    let dir = std::env::args().next_back().unwrap_or_default();
    let root = segment_store::Root::open(dir.as_ref()).unwrap_or_else(|error| {
        eprintln!("error: {error}");
        std::process::exit(1);
    });
    let mut output = BufWriter::new(std::io::stdout().lock());
    let cpu = segment_store::CpuFeatures {
        aes: !std::env::args().any(|argument| argument == "--without-aes"),
    };
    // An error means that the workstation was killed, which the tests do on purpose.
    let _ =
        segment_store::serve(&root, cpu, &mut |_| (), &mut std::io::stdin().lock(), &mut output)
            .and_then(|()| output.flush());
}
