//! Triangle meshes, and PLY files of them.

use super::solid::Solid;
use crate::grid::TileId;

/// A mesh of triangles. Vertices are shared within a solid and never between solids: Sionna finds
/// the wedges that diffract by shared indices.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// East, north and up from a tile's centre on the ground, in metres.
    pub vertices: Vec<[f32; 3]>,
    /// Indices of vertices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The mesh of solids around a tile's centre.
    #[must_use]
    pub fn of_solids<'a>(solids: impl IntoIterator<Item = &'a Solid>, tile: TileId) -> Self {
        let mut mesh = Self::default();
        for solid in solids {
            let offset = mesh.vertices.len() as u32;
            mesh.vertices.extend(solid.vertices([tile.easting, tile.northing]));
            mesh.triangles.extend(solid.faces().map(|face| face.map(|at| at + offset)));
        }
        mesh
    }

    /// A rectangle on the ground, seen from above: west, south, east, north in metres.
    #[must_use]
    pub fn ground([west, south, east, north]: [f32; 4]) -> Self {
        let corners = [[west, south], [east, south], [east, north], [west, north]];
        Self {
            vertices: corners.map(|[x, y]| [x, y, 0.0]).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        }
    }

    /// Whether every edge is shared by exactly two triangles that run through it in opposite
    /// directions, so that inside and outside are told apart everywhere.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        let edge = |from: u32, to: u32| (u64::from(from) << 32) | u64::from(to);
        let mut forth: Vec<u64> = Vec::with_capacity(3 * self.triangles.len());
        let mut back = forth.clone();
        for &[a, b, c] in &self.triangles {
            forth.extend([edge(a, b), edge(b, c), edge(c, a)]);
            back.extend([edge(b, a), edge(c, b), edge(a, c)]);
        }
        forth.sort_unstable();
        back.sort_unstable();
        forth == back && forth.windows(2).all(|pair| pair[0] < pair[1])
    }

    /// The volume inside of a closed mesh, in m³.
    #[must_use]
    pub fn volume_m3(&self) -> f64 {
        let sixfold = |&[a, b, c]: &[u32; 3]| {
            let [a, b, c] = [a, b, c].map(|at| self.vertices[at as usize].map(f64::from));
            let normal =
                [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
            a[0] * normal[0] + a[1] * normal[1] + a[2] * normal[2]
        };
        self.triangles.iter().map(sixfold).sum::<f64>() / 6.0
    }
}

/// Why bytes are no PLY file of this project.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PlyError {
    /// The header is another one than [`ply_bytes`] writes.
    #[error("no PLY header of a triangle mesh of float32 in binary little endian")]
    Header,
    /// The header announces other sizes than the file has.
    #[error("{expected} bytes are announced after the header, {found} are there")]
    Size {
        /// From the header.
        expected: u64,
        /// In the file.
        found: u64,
    },
    /// A face is no triangle, or names a vertex that is not there.
    #[error("face {face} is no triangle of the mesh's vertices")]
    Face {
        /// The face, from 0.
        face: usize,
    },
}

const VERTEX_BYTES: usize = 12;
const FACE_BYTES: usize = 13;

fn header(vertices: usize, faces: usize) -> String {
    format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\nproperty float x\n\
         property float y\nproperty float z\nelement face {faces}\n\
         property list uchar int vertex_indices\nend_header\n"
    )
}

/// A mesh as a binary PLY file: float32 coordinates, faces of an 8-bit count and int32 indices,
/// little endian.
///
/// # Panics
/// If the mesh has more than 2³¹ vertices.
#[must_use]
pub fn ply_bytes(mesh: &Mesh) -> Vec<u8> {
    let Mesh { vertices, triangles } = mesh;
    assert!(i32::try_from(vertices.len()).is_ok(), "indices in PLY files have 31 bits");
    let mut bytes = header(vertices.len(), triangles.len()).into_bytes();
    bytes.reserve(vertices.len() * VERTEX_BYTES + triangles.len() * FACE_BYTES);
    for coordinate in vertices.iter().flatten() {
        bytes.extend(coordinate.to_le_bytes());
    }
    for triangle in triangles {
        bytes.push(3);
        bytes.extend(triangle.iter().flat_map(|index| index.to_le_bytes()));
    }
    bytes
}

/// Reads back what [`ply_bytes`] wrote.
///
/// # Errors
/// [`PlyError`] for everything else, other valid PLY files included.
pub fn read_ply(bytes: &[u8]) -> Result<Mesh, PlyError> {
    const END: &[u8] = b"end_header\n";
    let end = bytes.windows(END.len()).position(|window| window == END);
    let (text, body) = bytes.split_at(end.ok_or(PlyError::Header)? + END.len());
    let text = std::str::from_utf8(text).map_err(|_| PlyError::Header)?;
    let count = |element: &str| -> Option<usize> {
        text.lines().find_map(|line| line.strip_prefix(element))?.parse().ok()
    };
    let counts = (count("element vertex "), count("element face "));
    let (Some(vertices), Some(faces)) = counts else {
        return Err(PlyError::Header);
    };
    if text != header(vertices, faces) {
        return Err(PlyError::Header);
    }
    let expected = (vertices as u64)
        .saturating_mul(VERTEX_BYTES as u64)
        .saturating_add((faces as u64).saturating_mul(FACE_BYTES as u64));
    let found = body.len() as u64;
    if expected != found {
        return Err(PlyError::Size { expected, found });
    }
    let (coordinates, indices) = body.split_at(vertices * VERTEX_BYTES);
    let word = |bytes: &[u8], at: usize| [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]];
    let vertex = |bytes: &[u8]| [0, 4, 8].map(|at| f32::from_le_bytes(word(bytes, at)));
    let triangle = |(face, bytes): (usize, &[u8])| {
        let triangle = [1, 5, 9].map(|at| u32::from_le_bytes(word(bytes, at)));
        let is_sound = bytes[0] == 3 && triangle.iter().all(|&at| (at as usize) < vertices);
        if is_sound { Ok(triangle) } else { Err(PlyError::Face { face }) }
    };
    Ok(Mesh {
        vertices: coordinates.chunks_exact(VERTEX_BYTES).map(vertex).collect(),
        triangles: indices
            .chunks_exact(FACE_BYTES)
            .enumerate()
            .map(triangle)
            .collect::<Result<_, _>>()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tetrahedron() -> Mesh {
        Mesh {
            vertices: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 6.0]],
            triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        }
    }

    #[test]
    fn meshes_round_trip_and_damaged_files_are_refused() {
        let bytes = ply_bytes(&tetrahedron());
        assert_eq!(read_ply(&bytes), Ok(tetrahedron()));
        assert_eq!(read_ply(&ply_bytes(&Mesh::default())), Ok(Mesh::default()));
        assert_eq!(read_ply(b"ply\n"), Err(PlyError::Header));
        let shorter = read_ply(&bytes[..bytes.len() - 1]);
        assert!(matches!(shorter, Err(PlyError::Size { expected: 100, found: 99 })), "{shorter:?}");
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let other = text.replacen("float x", "float u", 1);
        assert_eq!(read_ply(other.as_bytes()), Err(PlyError::Header));
        let huge = header(usize::MAX, usize::MAX);
        assert!(matches!(read_ply(huge.as_bytes()), Err(PlyError::Size { .. })));
        let mut wild = bytes;
        let last = wild.len() - 4;
        wild[last] = 4;
        assert_eq!(read_ply(&wild), Err(PlyError::Face { face: 3 }));
    }

    #[test]
    fn closed_meshes_are_told_from_open_and_inverted_ones() {
        let mesh = tetrahedron();
        assert!(mesh.is_closed());
        assert!((mesh.volume_m3() - 1.0).abs() < 1e-12);
        let open = Mesh { triangles: mesh.triangles[1..].to_vec(), ..mesh.clone() };
        assert!(!open.is_closed());
        let mut inverted = mesh;
        inverted.triangles[0] = [0, 1, 2];
        assert!(!inverted.is_closed());
    }

    #[test]
    fn the_ground_looks_up() {
        let Mesh { vertices, triangles } = Mesh::ground([-2.0, -1.0, 2.0, 1.0]);
        for [a, b, c] in triangles {
            let [a, b, c] = [a, b, c].map(|at| vertices[at as usize]);
            assert!((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) > 0.0);
        }
    }
}
