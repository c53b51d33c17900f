//! Exported policies: the weights are those of the manifest, and numbers.

use std::path::Path;

use safetensors::SafeTensors;
use safetensors::tensor::Dtype;

use super::failure::{VerifyFailure, failure};
use crate::manifest::PolicyManifest;
use crate::store::{MANIFEST, sha256_bytes};

/// Lists what is wrong, and returns the number of tensors.
pub(super) fn check(
    root: &Path,
    manifest: &PolicyManifest,
    failures: &mut Vec<VerifyFailure>,
) -> usize {
    const WEIGHTS: &str = PolicyManifest::WEIGHTS;
    let bytes = match std::fs::read(root.join(WEIGHTS)) {
        Ok(bytes) => bytes,
        Err(error) => {
            failures.push(failure(WEIGHTS, error.to_string()));
            return 0;
        }
    };
    let found = sha256_bytes(&bytes).sha256;
    if found != manifest.weights_sha256 {
        let reason = format!("SHA-256 is {found}, the manifest says {}", manifest.weights_sha256);
        failures.push(failure(WEIGHTS, reason));
    }
    let file = match SafeTensors::deserialize(&bytes) {
        Ok(file) => file,
        Err(error) => {
            failures.push(failure(WEIGHTS, format!("no safetensors: {error}")));
            return 0;
        }
    };
    let tensors = file.tensors();
    let mut parameters = 0;
    for (name, tensor) in &tensors {
        parameters += tensor.shape().iter().product::<usize>() as u64;
        if tensor.dtype() != Dtype::F32 {
            let reason = format!("{name} is {:?}, expected F32", tensor.dtype());
            failures.push(failure(WEIGHTS, reason));
            continue;
        }
        let numbers = tensor.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
        if let Some(wrong) = numbers.into_iter().find(|number| !number.is_finite()) {
            failures.push(failure(WEIGHTS, format!("{name} has {wrong}, expected finite numbers")));
        }
    }
    if parameters != manifest.parameters {
        let expected = manifest.parameters;
        let reason = format!("{parameters} parameters in {WEIGHTS}, the manifest says {expected}");
        failures.push(failure(MANIFEST, reason));
    }
    tensors.len()
}
