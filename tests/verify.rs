//! `verify` finds every flipped byte, every missing, foreign, cut or swapped file, and
//! damage that checksums made anew would hide.

mod pipeline;

use std::fs;
use std::path::Path;
use std::process::Stdio;

use pipeline::maps::SITE;
use pipeline::{
    DATASET_FILES, HELSINKI, Random, assert_says, copy_of, read, run, sha256, temporary_dir,
    verify, write,
};

/// Verifies something damaged; returns what was said.
fn refused(directory: &Path) -> String {
    run(&mut verify(directory)).refused()
}

/// Flips a byte at seeded places of a file, one after the other.
fn flip_bytes(root: &Path, name: &str, bytes: &[u8], flips: usize, random: &mut Random) {
    for _ in 0..flips {
        let (at, mask) = (random.below(bytes.len()), 1 + random.below(255) as u8);
        let mut damaged = bytes.to_vec();
        damaged[at] ^= mask;
        write(&root.join(name), damaged);
        let message = refused(root);
        // A damaged list blames itself, or the file that it lists wrongly.
        let blames = ["SHA256SUMS", "SHA-256 is", "No such file"];
        let listed = name == "SHA256SUMS" && blames.iter().any(|blame| message.contains(blame));
        let named = listed || message.contains(name);
        assert!(named, "byte {at} of {name} ^ {mask:#x}: {message}");
    }
    write(&root.join(name), bytes);
}

#[test]
fn any_flipped_byte_of_a_dataset_is_found() {
    let (_dir, root, files) = copy_of(&HELSINKI.dataset);
    let mut random = Random(21);
    for (name, bytes) in &files {
        flip_bytes(&root, name, bytes, 25, &mut random);
    }
    run(&mut verify(&root)).succeeds();
}

#[test]
fn any_flipped_byte_of_tiles_and_maps_is_found() {
    for stage in [&SITE.tiles, &HELSINKI.rsrp] {
        let (_dir, root, files) = copy_of(stage);
        let mut random = Random(22);
        let names: Vec<&String> = files.keys().collect();
        for _ in 0..15 {
            let name = names[random.below(names.len())];
            flip_bytes(&root, name, &files[name], 1, &mut random);
        }
        for name in ["manifest.json", "SHA256SUMS"] {
            flip_bytes(&root, name, &files[name], 5, &mut random);
        }
        run(&mut verify(&root)).succeeds();
    }
}

#[test]
fn any_missing_file_is_named() {
    let (_dir, root, files) = copy_of(&HELSINKI.dataset);
    for (name, bytes) in &files {
        fs::remove_file(root.join(name)).expect("removed");
        assert_says(&refused(&root), &[name]);
        write(&root.join(name), bytes);
    }
}

#[test]
fn any_foreign_file_is_named() {
    for stage in [&SITE.tiles, &HELSINKI.rsrp, &HELSINKI.dataset] {
        let (_dir, root, _) = copy_of(stage);
        for name in ["notes.txt", ".hidden", "train/shard-00001.msgpack.zst", "a/b/c"] {
            write(&root.join(name), "");
            assert_says(&refused(&root), &[name]);
            fs::remove_file(root.join(name)).expect("removed");
        }
    }
}

#[test]
fn cut_and_grown_shards_are_named() {
    let (_dir, root, files) = copy_of(&HELSINKI.dataset);
    let name = DATASET_FILES[4];
    let whole = &files[name];
    for length in [0, 1, 8, 17, whole.len() / 2, whole.len() - 9, whole.len() - 1] {
        write(&root.join(name), &whole[..length]);
        assert_says(&refused(&root), &[name]);
    }
    write(&root.join(name), [&whole[..], b"more"].concat());
    assert_says(&refused(&root), &[name]);
}

#[test]
fn swapped_shards_are_named() {
    let (_dir, root, files) = copy_of(&HELSINKI.dataset);
    let [train, val] = [DATASET_FILES[4], DATASET_FILES[5]];
    write(&root.join(train), &files[val]);
    write(&root.join(val), &files[train]);
    assert_says(&refused(&root), &[train, val]);
}

#[test]
fn what_is_no_output_is_refused_with_a_reason() {
    let dir = temporary_dir();
    let absent = dir.path().join("absent");
    assert_says(&refused(&absent), &["absent"]);
    assert_says(&refused(dir.path()), &["manifest.json"]);
    for text in ["", "[]", "{}", "{\"schema\": 7}", "{\"schema\": \"dataset.v2\"}"] {
        write(&dir.path().join("manifest.json"), text);
        assert_says(&refused(dir.path()), &["manifest.json"]);
    }
}

/// A reader of the report that has left does not make a bad dataset good.
#[test]
fn a_closed_pipe_does_not_hide_the_verdict() {
    let (_dir, root, _) = copy_of(&HELSINKI.dataset);
    let status = |root: &Path| {
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        let mut command = verify(root);
        let child = command.stdout(writer).stderr(Stdio::null()).spawn();
        child.expect("started").wait().expect("ended").code()
    };
    assert_eq!(status(&root), Some(0), "sound");
    fs::remove_file(root.join("NOTICE")).expect("removed");
    assert_eq!(status(&root), Some(3), "damaged");
}

/// A list of checksums that leads out of the directory is not followed in silence.
#[test]
fn listed_files_lie_in_the_directory() {
    let (dir, root, files) = copy_of(&HELSINKI.dataset);
    write(&dir.path().join("outside.txt"), "text");
    let mut sums = files["SHA256SUMS"].clone();
    sums.extend(format!("{}  ../outside.txt\n", sha256(b"text")).bytes());
    write(&root.join("SHA256SUMS"), sums);
    assert_says(&refused(&root), &["../outside.txt"]);
    assert_eq!(read(&dir.path().join("outside.txt")), b"text");
}

/// A byte of the table at the end of a shard, with all checksums made anew.
#[test]
fn damaged_seek_tables_are_named_though_checksums_fit() {
    let (_dir, root, files) = copy_of(&HELSINKI.dataset);
    let name = DATASET_FILES[4];
    let whole = &files[name];
    let (old_sha, old_length) = (sha256(whole), whole.len());
    let table = 8 + 8 * 12 + 9;
    let mut random = Random(23);
    for _ in 0..20 {
        let mut damaged = whole.clone();
        let at = damaged.len() - 1 - random.below(table);
        damaged[at] ^= 1 + random.below(255) as u8;
        for list in ["manifest.json", "SHA256SUMS"] {
            let text = String::from_utf8(files[list].clone()).expect("text");
            write(&root.join(list), text.replace(&old_sha, &sha256(&damaged)));
        }
        let manifest = read(&root.join("manifest.json"));
        let sums = String::from_utf8(read(&root.join("SHA256SUMS"))).expect("text");
        let sums = sums.replace(&sha256(&files["manifest.json"]), &sha256(&manifest));
        write(&root.join("SHA256SUMS"), sums);
        write(&root.join(name), &damaged);
        assert_eq!(damaged.len(), old_length);
        let message = refused(&root);
        assert_says(&message, &[name]);
        assert!(!message.contains("SHA-256 is"), "checksums fit: {message}");
    }
}
