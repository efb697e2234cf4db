//! What callers can rely on when they verify, sign and transfer models.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set up its files has failed"
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
            read_secret_key(&self.dir.path().join("key"), || panic!("the key is not encrypted"))
                .unwrap();
        sign(model, name, &key).unwrap()
    }

    fn trusted(&self) -> TrustedKeys {
        TrustedKeys::parse(&self.trusted_line, Path::new("trusted_keys")).unwrap()
    }
}

#[test]
fn a_model_signed_by_a_trusted_key_is_accepted_with_its_name_digest_and_signer() {
    let signer = Signer::new();
    let signed = verify(MODEL, &signer.sign(MODEL, "kitchen-7"), &signer.trusted()).unwrap();
    assert_eq!((signed.name.as_str(), signed.by.as_str()), ("kitchen-7", "workshop"));
    assert_eq!(signed.digest, blake3::hash(MODEL).to_hex().as_str());
}

#[test]
fn a_signature_by_an_unknown_key_is_refused_and_the_error_lists_the_trusted_keys() {
    let signer = Signer::new();
    let stranger = Signer::new();
    let error = verify(MODEL, &stranger.sign(MODEL, "m"), &signer.trusted()).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::UntrustedKey);
    assert!(error.to_string().contains("workshop"), "{error}");
}

#[test]
fn several_keys_can_be_trusted_at_once() {
    let one = Signer::new();
    let two = Signer::new();
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
fn a_signature_whose_comment_does_not_describe_the_model_is_refused() {
    let signer = Signer::new();
    let key = read_secret_key(&signer.dir.path().join("key"), || panic!()).unwrap();
    for comment in ["timestamp:1", "model=m blake3=00", "model=../m blake3=00", ""] {
        let signature = minisign::sign(None, &key, MODEL, Some(comment), None).unwrap().to_string();
        let error = verify(MODEL, &signature, &signer.trusted()).unwrap_err();
        assert!(matches!(error, BundleError::Comment { .. }), "{comment}: {error}");
    }
}

#[test]
fn an_encrypted_key_is_read_only_with_its_password() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("key");
    generate_keys(&path, Some("open sesame".to_owned()), "").unwrap();
    assert!(read_secret_key(&path, || Ok("open sesame".to_owned())).is_ok());
    let error = read_secret_key(&path, || Ok("wrong".to_owned())).unwrap_err();
    assert!(matches!(error, BundleError::SecretKey { .. }), "{error}");
}

#[test]
fn a_secret_key_is_readable_by_its_owner_only_and_is_never_overwritten() {
    use std::os::unix::fs::PermissionsExt;
    let signer = Signer::new();
    let path = signer.dir.path().join("key");
    assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
    assert!(matches!(generate_keys(&path, None, "").unwrap_err(), BundleError::KeyExists { .. }));
}

#[test]
fn an_unsigned_model_is_refused_with_the_command_that_signs_it() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("m.onnx");
    std::fs::write(&path, MODEL).unwrap();
    let error = Bundle::read_files(&path).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsigned);
    assert!(error.to_string().contains("push-model sign"), "{error}");
}

#[test]
fn a_missing_empty_or_malformed_file_of_trusted_keys_is_refused_with_a_way_out() {
    let path = Path::new("/nowhere/trusted_keys");
    assert!(TrustedKeys::read(path).unwrap_err().to_string().contains("push-model keygen"));
    assert!(TrustedKeys::parse("# no key yet\n", path).is_err());
    let error = TrustedKeys::parse("\nRWabc workshop", path).unwrap_err().to_string();
    assert!(error.contains("line 2") && error.contains("RWabc"), "{error}");
}

#[test]
fn names_that_are_not_safe_as_file_names_are_refused() {
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
fn a_bundle_survives_its_stream_and_every_truncation_is_an_error() {
    let mut stream = Vec::new();
    some_bundle().write_stream(&mut stream).unwrap();
    assert_eq!(Bundle::read_stream(&stream[..]).unwrap(), some_bundle());
    for length in 0..stream.len() {
        assert!(Bundle::read_stream(&stream[..length]).is_err(), "{length}");
    }
}

#[test]
fn a_stream_that_announces_too_large_a_size_is_refused_before_anything_is_allocated() {
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

#[test]
fn a_signature_changed_at_any_byte_is_refused_unless_only_its_untrusted_comment_changed() {
    let signer = Signer::new();
    let trusted = signer.trusted();
    let signature = signer.sign(MODEL, "m").into_bytes();
    let untrusted_len = signature.iter().position(|byte| *byte == b'\n').unwrap();
    for place in 0..signature.len() {
        for to in [signature[place] ^ 1, b' ', b'A', b'='] {
            if to == signature[place] {
                continue;
            }
            let mut changed = signature.clone();
            changed[place] = to;
            let text = String::from_utf8(changed).unwrap();
            let verified = verify(MODEL, &text, &trusted);
            // The first line, the untrusted comment, is not signed.
            if place < untrusted_len {
                assert!(verified.is_ok_and(|signed| signed.name == "m"), "{text}");
            } else {
                assert!(verified.is_err(), "byte {place}: {text}");
            }
        }
    }
}

proptest! {
    #[test]
    fn a_model_with_a_flipped_bit_or_a_missing_end_is_refused(place in 0..MODEL.len(), bit in 0..8u8) {
        let signer = Signer::new();
        let signature = signer.sign(MODEL, "m");
        let mut changed = MODEL.to_vec();
        changed[place] ^= 1 << bit;
        prop_assert_eq!(verify(&changed, &signature, &signer.trusted()).unwrap_err().kind(), ErrorKind::Forged);
        prop_assert_eq!(verify(&MODEL[..place], &signature, &signer.trusted()).unwrap_err().kind(), ErrorKind::Forged);
    }

    #[test]
    fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = Bundle::read_stream(&bytes[..]);
        let text = String::from_utf8_lossy(&bytes);
        let _ = verify(MODEL, &text, &Signer::new().trusted());
    }
}
