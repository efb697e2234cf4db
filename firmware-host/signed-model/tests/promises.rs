//! What a bundle promises.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set up its scene has failed"
)]

use std::path::Path;

use proptest::prelude::*;
use signed_model::{
    Bundle, BundleError, ErrorKind, TrustedKeys, generate_keys, read_secret_key, sign, verify,
};

const MODEL: &[u8] = b"the bytes of a model";

struct Signer {
    dir: tempfile::TempDir,
    trusted_line: String,
}

impl Signer {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let trusted_line = generate_keys(&dir.path().join("key"), None, "workshop").unwrap();
        Self { dir, trusted_line }
    }

    fn sign(&self, model: &[u8], name: &str) -> String {
        let key =
            read_secret_key(&self.dir.path().join("key"), || panic!("the key has no password"))
                .unwrap();
        sign(model, name, &key).unwrap()
    }

    fn trusted(&self) -> TrustedKeys {
        TrustedKeys::parse(&self.trusted_line, Path::new("trusted_keys")).unwrap()
    }
}

#[test]
fn what_a_trusted_key_signed_is_taken_with_its_name_digest_and_signer() {
    let signer = Signer::new();
    let signed = verify(MODEL, &signer.sign(MODEL, "kitchen-7"), &signer.trusted()).unwrap();
    assert_eq!((signed.name.as_str(), signed.by.as_str()), ("kitchen-7", "workshop"));
    assert_eq!(signed.digest, blake3::hash(MODEL).to_hex().as_str());
}

#[test]
fn a_signature_by_another_key_is_refused_and_the_trusted_ones_are_named() {
    let (signer, stranger) = (Signer::new(), Signer::new());
    let error = verify(MODEL, &stranger.sign(MODEL, "m"), &signer.trusted()).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::UntrustedKey);
    assert!(error.to_string().contains("workshop"), "{error}");
}

#[test]
fn several_keys_may_be_trusted_at_once() {
    let (one, two) = (Signer::new(), Signer::new());
    let text = format!("# robots of the lab\n{}\n\n{}\n", one.trusted_line, two.trusted_line);
    let keys = TrustedKeys::parse(&text, Path::new("trusted_keys")).unwrap();
    assert_eq!(keys.keys().len(), 2);
    for signer in [&one, &two] {
        assert!(verify(MODEL, &signer.sign(MODEL, "m"), &keys).is_ok());
    }
}

#[test]
fn a_signed_comment_that_was_changed_is_refused() {
    let signer = Signer::new();
    let signature = signer.sign(MODEL, "careful");
    let renamed = signature.replace("model=careful", "model=reckless");
    assert_ne!(signature, renamed);
    assert_eq!(verify(MODEL, &renamed, &signer.trusted()).unwrap_err().kind(), ErrorKind::Forged);
}

#[test]
fn a_signature_without_our_comment_is_no_signature_of_a_model() {
    let signer = Signer::new();
    let key = read_secret_key(&signer.dir.path().join("key"), || panic!()).unwrap();
    for comment in ["timestamp:1", "model=m blake3=00", "model=../m blake3=00", ""] {
        let signature = minisign::sign(None, &key, MODEL, Some(comment), None).unwrap().to_string();
        let error = verify(MODEL, &signature, &signer.trusted()).unwrap_err();
        assert!(matches!(error, BundleError::Comment { .. }), "{comment}: {error}");
    }
}

#[test]
fn a_key_with_a_password_signs_only_with_it() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("key");
    generate_keys(&path, Some("open sesame".to_owned()), "").unwrap();
    assert!(read_secret_key(&path, || Ok("open sesame".to_owned())).is_ok());
    let error = read_secret_key(&path, || Ok("wrong".to_owned())).unwrap_err();
    assert!(matches!(error, BundleError::SecretKey { .. }), "{error}");
}

#[test]
fn a_secret_key_is_its_owners_alone_and_is_never_overwritten() {
    use std::os::unix::fs::PermissionsExt;
    let signer = Signer::new();
    let path = signer.dir.path().join("key");
    assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    assert!(matches!(generate_keys(&path, None, "").unwrap_err(), BundleError::KeyExists { .. }));
}

#[test]
fn a_model_without_a_signature_beside_it_is_told_how_to_sign() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.onnx");
    std::fs::write(&path, MODEL).unwrap();
    let error = Bundle::read_files(&path).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsigned);
    assert!(error.to_string().contains("push-model sign"), "{error}");
}

#[test]
fn a_file_of_trusted_keys_that_is_missing_empty_or_wrong_says_what_to_write() {
    let path = Path::new("/nowhere/trusted_keys");
    assert!(TrustedKeys::read(path).unwrap_err().to_string().contains("push-model keygen"));
    assert!(TrustedKeys::parse("# nobody yet\n", path).is_err());
    let error = TrustedKeys::parse("\nRWabc workshop", path).unwrap_err().to_string();
    assert!(error.contains("line 2") && error.contains("RWabc"), "{error}");
}

#[test]
fn names_that_could_leave_a_folder_are_refused() {
    let signer = Signer::new();
    let key = read_secret_key(&signer.dir.path().join("key"), || panic!()).unwrap();
    for name in ["", "..", ".hidden", "a/b", "a b", "a\nb", &"x".repeat(65)] {
        assert!(matches!(sign(MODEL, name, &key), Err(BundleError::Name { .. })), "{name:?}");
    }
}

fn some_bundle() -> Bundle {
    Bundle { name: "m-1".to_owned(), model: MODEL.to_vec(), signature: "signature".to_owned() }
}

#[test]
fn a_stream_gives_back_the_bundle_and_breaks_off_nowhere_unnoticed() {
    let mut stream = Vec::new();
    some_bundle().write_stream(&mut stream).unwrap();
    assert_eq!(Bundle::read_stream(&stream[..]).unwrap(), some_bundle());
    for length in 0..stream.len() {
        assert!(Bundle::read_stream(&stream[..length]).is_err(), "{length}");
    }
}

#[test]
fn a_stream_that_promises_too_much_is_refused_before_anything_is_allocated() {
    let line = format!("embodied-depth bundle 1\nm {} 10\n", u64::MAX);
    assert!(matches!(
        Bundle::read_stream(line.as_bytes()).unwrap_err(),
        BundleError::TooLarge { what: "model", .. }
    ));
    let line = "embodied-depth bundle 1\nm 1 99999\nx";
    assert!(matches!(
        Bundle::read_stream(line.as_bytes()).unwrap_err(),
        BundleError::TooLarge { what: "signature", .. }
    ));
}

proptest! {
    #[test]
    fn a_model_changed_at_any_byte_or_cut_anywhere_is_refused(place in 0..MODEL.len(), bit in 0..8u8) {
        let signer = Signer::new();
        let signature = signer.sign(MODEL, "m");
        let mut changed = MODEL.to_vec();
        changed[place] ^= 1 << bit;
        prop_assert_eq!(verify(&changed, &signature, &signer.trusted()).unwrap_err().kind(), ErrorKind::Forged);
        prop_assert_eq!(verify(&MODEL[..place], &signature, &signer.trusted()).unwrap_err().kind(), ErrorKind::Forged);
    }

    #[test]
    fn a_signature_changed_at_any_byte_is_refused_or_says_the_same(place in 0..330usize, to in 32..127u8) {
        let signer = Signer::new();
        let mut signature = signer.sign(MODEL, "m").into_bytes();
        let place = place % signature.len();
        signature[place] = to;
        let text = String::from_utf8(signature).unwrap();
        // The untrusted comment is not signed, and nobody reads it.
        if let Ok(signed) = verify(MODEL, &text, &signer.trusted()) {
            prop_assert_eq!(signed.name, "m");
        }
    }

    #[test]
    fn any_bytes_are_a_bundle_or_an_error(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = Bundle::read_stream(&bytes[..]);
        let text = String::from_utf8_lossy(&bytes);
        let _ = verify(MODEL, &text, &Signer::new().trusted());
    }
}
