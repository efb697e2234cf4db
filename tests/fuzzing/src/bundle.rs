use signed_model::{Bundle, TrustedKeys, verify};

/// A public key whose secret half is nobody's.
const KEY: &str = "RWQf6LRCGA9i53mlYecO4IzT51TGPpvWucNSCh1CBM0QTaLn73Y7GFO3 minisign's own example";

/// Arbitrary bytes as the stream in which a model travels, and as a file of trusted keys: what is read is written as it came, and
/// nobody's signature is taken.
pub fn bundle(bytes: &[u8]) {
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = TrustedKeys::parse(text, "keys".as_ref());
    }
    let Ok(bundle) = Bundle::read_stream(bytes) else { return };
    let mut again = Vec::new();
    bundle.write_stream(&mut again).expect("memory takes everything");
    assert_eq!(Bundle::read_stream(&again[..]).expect("what was written can be read"), bundle);
    let keys = TrustedKeys::parse(KEY, "keys".as_ref()).expect("a key");
    assert!(verify(&bundle.model, &bundle.signature, &keys).is_err());
}
