//! Exported policies: the weights are those of the manifest, and numbers.

use std::path::Path;

use safetensors::SafeTensors;
use safetensors::tensor::Dtype;

use super::failure::{VerifyFailure, failure};
use crate::manifest::PolicyManifest;
use crate::store::{MANIFEST, sha256_bytes};

const WEIGHTS: &str = PolicyManifest::WEIGHTS;

/// Lists what is wrong, and returns the number of tensors.
pub(super) fn check(
    root: &Path,
    manifest: &PolicyManifest,
    failures: &mut Vec<VerifyFailure>,
) -> usize {
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use safetensors::serialize;
    use safetensors::tensor::TensorView;

    use super::*;
    use crate::config::{RlConfig, TrainConfig};
    use crate::manifest::{Manifest, Software};

    fn manifest(weights: &[u8], parameters: u64) -> PolicyManifest {
        PolicyManifest {
            schema: PolicyManifest::SCHEMA.to_owned(),
            fingerprint: String::new(),
            software: Software::this(),
            weights_sha256: sha256_bytes(weights).sha256,
            parameters,
            cells: 121,
            cell_m: 4.0,
            dataset_sha256: String::new(),
            updates: 1,
            score: None,
            rl: RlConfig::default(),
            train: TrainConfig::default(),
        }
    }

    fn weights(numbers: [f32; 2]) -> Vec<u8> {
        let bytes = numbers.map(f32::to_le_bytes).concat();
        let tensor = TensorView::new(Dtype::F32, vec![2], &bytes).expect("a tensor");
        serialize(BTreeMap::from([("bias", tensor)]), &None).expect("written")
    }

    #[test]
    fn weights_are_those_of_the_manifest_and_numbers() {
        let dir = tempfile::tempdir().expect("a directory");
        let reasons = |bytes: &[u8], manifest: &PolicyManifest| {
            std::fs::write(dir.path().join(WEIGHTS), bytes).expect("written");
            let mut failures = Vec::new();
            check(dir.path(), manifest, &mut failures);
            failures.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
        };
        let sound = weights([1.0, 2.0]);
        assert_eq!(reasons(&sound, &manifest(&sound, 2)), "");
        assert!(reasons(&sound, &manifest(&sound, 3)).contains("the manifest says 3"));
        let nan = weights([1.0, f32::NAN]);
        assert!(reasons(&nan, &manifest(&nan, 2)).contains("bias has NaN"));
        let others = reasons(&weights([1.0, 3.0]), &manifest(&sound, 2));
        assert!(others.contains("SHA-256 is"), "{others}");
        assert!(reasons(b"text", &manifest(b"text", 2)).contains("no safetensors"));
    }
}
