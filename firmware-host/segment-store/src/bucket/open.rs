//! Opening an object store by its URL.

use std::sync::Arc;

use crate::StoreError;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey};
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{BackoffConfig, ClientConfigKey, ObjectStore, ObjectStoreScheme, RetryConfig};
use url::Url;

use super::error::{bad_address, explain};

/// A reachable server accepts the connection within this time.
const CONNECT_TIMEOUT: &str = "10 seconds";

/// Attempts per request. The pull itself retries as well.
const TRIES: usize = 3;

/// Opens the store at a URL, and returns it with the prefix that the URL names.
pub(crate) fn open_store(
    text: &str,
    stall_s: u64,
) -> Result<(Arc<dyn ObjectStore>, Path), StoreError> {
    let url = Url::parse(text).map_err(|error| bad_address(text, &error.to_string()))?;
    let (scheme, prefix) =
        ObjectStoreScheme::parse(&url).map_err(|error| bad_address(text, &error.to_string()))?;
    // Fails only when the program has already installed a provider, which is then used.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let retry = RetryConfig {
        max_retries: TRIES - 1,
        retry_timeout: std::time::Duration::from_secs(stall_s),
        backoff: BackoffConfig::default(),
    };
    // A request over a slow link may take an hour as long as data keep arriving.
    let stall = format!("{stall_s} seconds");
    let client = [
        (ClientConfigKey::ConnectTimeout, CONNECT_TIMEOUT),
        (ClientConfigKey::ReadTimeout, stall.as_str()),
        (ClientConfigKey::Timeout, "1 hour"),
    ];
    let store: Result<Arc<dyn ObjectStore>, _> = match scheme {
        ObjectStoreScheme::AmazonS3 => client
            .into_iter()
            .fold(AmazonS3Builder::from_env().with_url(text), |s3, (key, value)| {
                s3.with_config(AmazonS3ConfigKey::Client(key), value)
            })
            .with_retry(retry)
            .build()
            .map(|s3| Arc::new(s3) as _),
        ObjectStoreScheme::GoogleCloudStorage => client
            .into_iter()
            .fold(GoogleCloudStorageBuilder::from_env().with_url(text), |gs, (key, value)| {
                gs.with_config(GoogleConfigKey::Client(key), value)
            })
            .with_retry(retry)
            .build()
            .map(|gs| Arc::new(gs) as _),
        ObjectStoreScheme::MicrosoftAzure => client
            .into_iter()
            .fold(MicrosoftAzureBuilder::from_env().with_url(text), |az, (key, value)| {
                az.with_config(AzureConfigKey::Client(key), value)
            })
            .with_retry(retry)
            .build()
            .map(|az| Arc::new(az) as _),
        ObjectStoreScheme::Local => {
            let dir =
                url.to_file_path().map_err(|()| bad_address(text, "it is not a local path"))?;
            let store = LocalFileSystem::new_with_prefix(dir).map(|store| Arc::new(store) as _);
            return store
                .map(|store| (store, Path::default()))
                .map_err(|error| explain(text, &error, "open"));
        }
        _ => return Err(bad_address(text, "unknown kind of object store")),
    };
    Ok((store.map_err(|error| explain(text, &error, "open"))?, prefix))
}
