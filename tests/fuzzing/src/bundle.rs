use signed_model::{Bundle, TrustedKeys, verify};

/// A public key whose secret key is not available.
const KEY: &str = "RWQf6LRCGA9i53mlYecO4IzT51TGPpvWucNSCh1CBM0QTaLn73Y7GFO3 minisign's own example";

/// Arbitrary bytes as the stream in which a model is sent, and as a file of trusted keys. A bundle
/// that can be read is written back unchanged, and no untrusted signature is accepted.
pub fn bundle(bytes: &[u8]) {
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = TrustedKeys::parse(text, "keys".as_ref());
    }
    let Ok(bundle) = Bundle::read_stream(bytes) else { return };
    let mut again = Vec::new();
    bundle.write_stream(&mut again).expect("writing to memory succeeds");
    assert_eq!(Bundle::read_stream(&again[..]).expect("a written bundle can be read"), bundle);
    let keys = TrustedKeys::parse(KEY, "keys".as_ref()).expect("a key");
    assert!(verify(&bundle.model, &bundle.signature, &keys).is_err());
}
