//! Places on disk: the manifest, and its index and scenes beside it.

use crate::files;
use crate::import::sha256_hex;
use crate::reveals::{outline, revealed};
use anyhow::{Context, Result, bail, ensure};
use landline::place::{FileRef, PlaceIndex, PlaceManifest, RoomEntry};
use landline::scene_file::SceneFile;
use std::path::{Path, PathBuf};

/// Ending of a manifest, and of the index beside it.
const MANIFEST_ENDING: &str = ".place.json";
const INDEX_ENDING: &str = ".place.index";
/// Ending of a scene file.
const SCENE_ENDING: &str = "landline";

/// A place with what knows its rooms.
#[derive(Debug, Clone)]
pub struct PlaceFiles {
    path: PathBuf,
    /// The rooms.
    pub manifest: PlaceManifest,
    /// What tells them apart.
    pub index: PlaceIndex,
}

/// The index that belongs to a manifest's path.
///
/// # Errors
/// For a path that is not called like a manifest.
fn index_path(path: &Path) -> Result<PathBuf> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    match name.strip_suffix(MANIFEST_ENDING) {
        Some(stem) if !stem.is_empty() => Ok(path.with_file_name(format!("{stem}{INDEX_ENDING}"))),
        _ => bail!(
            "{} is not called NAME{MANIFEST_ENDING}, as places are",
            path.display()
        ),
    }
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// A file beside a manifest as the manifest names it.
fn file_ref(manifest: &Path, file: &Path, bytes: &[u8]) -> Result<FileRef> {
    let folder = folder_of(manifest);
    let whole = |path: &Path| {
        let made = std::fs::canonicalize(path);
        made.with_context(|| format!("cannot find {}", path.display()))
    };
    let (folder, file) = (whole(folder)?, whole(file)?);
    let relative = file.strip_prefix(&folder).ok().with_context(|| {
        format!(
            "{} does not lie in the folder of the place, {}: pages could not fetch it from beside the place",
            file.display(),
            folder.display()
        )
    })?;
    let parts: Vec<_> = relative.iter().map(|part| part.to_string_lossy()).collect();
    let url = parts.join("/");
    ensure!(
        !url.contains(['#', '?', '%', '\\', ':']),
        "{url:?} cannot be part of an address: rename the file without # ? % \\ :"
    );
    Ok(FileRef {
        url,
        bytes: bytes.len() as u64,
        sha256: sha256_hex(bytes),
    })
}

/// A scene file, read and named.
struct Named {
    id: String,
    file: FileRef,
    scene: SceneFile,
}

impl Named {
    fn read(manifest: &Path, file: &Path, id: Option<&str>) -> Result<Self> {
        let bytes =
            std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
        let scene = SceneFile::from_bytes(&bytes)
            .with_context(|| format!("cannot use scene {}", file.display()))?;
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        Ok(Self {
            id: id.map_or_else(|| stem.into_owned(), str::to_owned),
            file: file_ref(manifest, file, &bytes)?,
            scene,
        })
    }
}

impl PlaceFiles {
    /// A place of all scene files of a folder. What a manifest that is there says of a room beside its scene (names, floors,
    /// neighbours, transforms) stays.
    ///
    /// # Errors
    /// When a scene cannot be read or does not fit the others.
    pub fn build(path: &Path, scenes: &Path) -> Result<Self> {
        let index_path = index_path(path)?;
        let before = path.exists().then(|| read_manifest(path)).transpose()?;
        let mut found = files::entries(scenes)?;
        found.retain(|p| p.extension().is_some_and(|e| e == SCENE_ENDING));
        let read = |file: &PathBuf| Named::read(path, file, None);
        let named: Vec<Named> = found.iter().map(read).collect::<Result<_>>()?;
        let Some(first) = named.first() else {
            bail!(
                "there is no scene (NAME.{SCENE_ENDING}) in {}",
                scenes.display()
            );
        };
        let mut manifest = PlaceManifest::for_scenes_like(&first.scene.info, first.file.clone());
        if let Some(before) = &before {
            manifest.name.clone_from(&before.name);
        }
        for room in &named {
            manifest.check_scene(&room.id, &room.scene)?;
            let known = before
                .as_ref()
                .and_then(|b| b.rooms.get(b.position(&room.id)?));
            manifest.rooms.push(entry(room, known));
        }
        let ids: Vec<String> = manifest.rooms.iter().map(|room| room.id.clone()).collect();
        for room in &mut manifest.rooms {
            room.neighbours.retain(|id| ids.contains(id));
        }
        let scenes: Vec<(&str, &SceneFile)> =
            named.iter().map(|n| (n.id.as_str(), &n.scene)).collect();
        let mut files = Self {
            path: path.to_owned(),
            manifest,
            index: PlaceIndex::build(&scenes)?,
        };
        files.write_to(&index_path)?;
        Ok(files)
    }

    /// Reads a place; its scenes are not looked at.
    ///
    /// # Errors
    /// When manifest or index cannot be read, or the index is another one.
    pub fn read(path: &Path) -> Result<Self> {
        let manifest = read_manifest(path)?;
        let bytes = read_file(path, &manifest.index)?;
        let index = PlaceIndex::from_bytes(&bytes)?;
        Ok(Self {
            path: path.to_owned(),
            manifest,
            index,
        })
    }

    /// Adds a scene, or takes a room's scene that was taught anew. The other rooms are not touched. The room's name is the
    /// file's, unless it is told.
    ///
    /// # Errors
    /// When the scene cannot be read or does not fit the place.
    pub fn add(&mut self, file: &Path, id: Option<&str>) -> Result<String> {
        let room = Named::read(&self.path, file, id)?;
        self.manifest.check_scene(&room.id, &room.scene)?;
        self.index.add(&room.id, &room.scene)?;
        match self.manifest.position(&room.id) {
            Some(at) => {
                let known = self.manifest.rooms.get(at).cloned();
                if let Some(slot) = self.manifest.rooms.get_mut(at) {
                    *slot = entry(&room, known.as_ref());
                }
            }
            None => self.manifest.rooms.push(entry(&room, None)),
        }
        Ok(room.id)
    }

    /// Puts two rooms beside each other.
    ///
    /// # Errors
    /// When there is no such room, or they are one.
    pub fn join(&mut self, a: &str, b: &str) -> Result<()> {
        ensure!(a != b, "room {a:?} cannot be its own neighbour");
        for (room, neighbour) in [(a, b), (b, a)] {
            let at = self.manifest.position(room);
            let Some(entry) = at.and_then(|at| self.manifest.rooms.get_mut(at)) else {
                bail!("there is no room {room:?}");
            };
            if !entry.neighbours.iter().any(|n| n == neighbour) {
                entry.neighbours.push(neighbour.to_owned());
            }
        }
        Ok(())
    }

    /// Takes a room out. Its scene file stays.
    ///
    /// # Errors
    /// When there is no such room.
    pub fn remove(&mut self, id: &str) -> Result<()> {
        let Some(at) = self.manifest.position(id) else {
            bail!("there is no room {id:?}");
        };
        self.manifest.rooms.remove(at);
        for room in &mut self.manifest.rooms {
            room.neighbours.retain(|neighbour| neighbour != id);
        }
        self.index.remove(id);
        Ok(())
    }

    /// Writes manifest and index.
    ///
    /// # Errors
    /// When the place is not valid, or the disk refuses.
    pub fn write(&mut self) -> Result<()> {
        let index_path = index_path(&self.path)?;
        self.write_to(&index_path)
    }

    fn write_to(&mut self, index_path: &Path) -> Result<()> {
        let bytes = self.index.to_bytes()?;
        files::write_bytes(index_path, &bytes)?;
        self.manifest.index = file_ref(&self.path, index_path, &bytes)?;
        let text = self.manifest.to_json()?;
        files::write_bytes(&self.path, text.as_bytes())?;
        Ok(())
    }

    /// A room's scene, checked to be the one that the place was built with.
    ///
    /// # Errors
    /// When it is missing, another one, or does not fit.
    pub fn scene(&self, room: usize) -> Result<SceneFile> {
        let Some(entry) = self.manifest.rooms.get(room) else {
            bail!("there is no room number {room}");
        };
        let in_room = || format!("room {:?}", entry.id);
        let bytes = read_file(&self.path, &entry.scene).with_context(in_room)?;
        let scene = SceneFile::from_bytes(&bytes).with_context(in_room)?;
        self.manifest.check_scene(&entry.id, &scene)?;
        Ok(scene)
    }
}

fn entry(room: &Named, known: Option<&RoomEntry>) -> RoomEntry {
    let known = known.cloned();
    // One that was drawn by hand is right as long as the world is the same.
    let same = known
        .as_ref()
        .filter(|k| k.scene.sha256 == room.file.sha256);
    let drawn = same.map(|k| k.outline.clone()).filter(|o| !o.is_empty());
    RoomEntry {
        outline: drawn.unwrap_or_else(|| {
            let corners = outline(&revealed(&room.scene).map, room.scene.info.gravity);
            corners.iter().map(|corner| (*corner).into()).collect()
        }),
        id: room.id.clone(),
        name: known.as_ref().and_then(|k| k.name.clone()),
        scene: room.file.clone(),
        place_from_room: known.as_ref().and_then(|k| k.place_from_room),
        floor: known.as_ref().and_then(|k| k.floor),
        neighbours: known.map_or_else(Vec::new, |k| k.neighbours),
    }
}

fn read_manifest(path: &Path) -> Result<PlaceManifest> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    PlaceManifest::from_json(&text).with_context(|| format!("cannot use {}", path.display()))
}

/// A file that a manifest names, checked.
fn read_file(manifest: &Path, file: &FileRef) -> Result<Vec<u8>> {
    ensure!(
        !file.url.contains("://"),
        "{} is fetched by pages; this tool reads what lies beside the place",
        file.url
    );
    let path = folder_of(manifest).join(&file.url);
    let bytes = std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
    file.check(bytes.len() as u64, &sha256_hex(&bytes))?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_called_by_its_manifest() {
        let index = |path: &str| index_path(Path::new(path)).ok();
        assert_eq!(
            index("a/museum.place.json"),
            Some(PathBuf::from("a/museum.place.index"))
        );
        assert_eq!(index("museum.json"), None);
        assert_eq!(index(".place.json"), None);
    }
}
