//! Source files as `syn` reads them, and which file imports from which.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use proc_macro2::{TokenStream, TokenTree};
use quote::ToTokens;
use syn::visit::{self, Visit};
use syn::{Attribute, File, Item, ItemUse, UseTree, Visibility};

/// A source file of the repository.
pub(crate) struct Source {
    /// Its path from the root of the repository, with `/`.
    pub(crate) path: String,
    lines: usize,
    /// Its code, unit tests left out.
    file: File,
    /// Its code with the tests.
    whole: TokenStream,
}

impl Source {
    pub(crate) fn new(path: &str, text: &str) -> Self {
        let mut file =
            syn::parse_file(text).unwrap_or_else(|error| panic!("{path} is no Rust: {error}"));
        let whole = file.to_token_stream();
        let first_test = file.items.iter().position(is_test_module);
        let lines = match first_test {
            // Everything before the attribute `#[cfg(test)]`.
            Some(at) => first_line(&file.items[at]) - 1,
            None => text.lines().count(),
        };
        file.items.retain(|item| !is_test_module(item));
        Self { path: path.to_owned(), lines, file, whole }
    }

    /// The top-level module of the library that it belongs to.
    pub(crate) fn module(&self) -> Option<&str> {
        let first = self.path.strip_prefix("src/")?.split('/').next()?;
        let module = first.strip_suffix(".rs").unwrap_or(first);
        (module != "lib").then_some(module)
    }

    /// The names of its module, from the root of the crate.
    fn names(&self) -> Vec<String> {
        let below = self.path.strip_prefix("src/").unwrap_or(&self.path);
        let mut names: Vec<&str> = below.trim_end_matches(".rs").split('/').collect();
        if matches!(names.last(), Some(&"mod" | &"lib")) {
            names.pop();
        }
        names.into_iter().map(str::to_owned).collect()
    }

    pub(crate) fn lines_without_tests(&self) -> usize {
        self.lines
    }

    /// Identifiers and punctuation, in their order, the tests included.
    pub(crate) fn words(&self) -> Vec<String> {
        words_of(self.whole.clone())
    }

    /// Names of the types that it declares, tests apart.
    pub(crate) fn types(&self) -> Vec<String> {
        let name = |item: &Item| match item {
            Item::Struct(item) => Some(item.ident.to_string()),
            Item::Enum(item) => Some(item.ident.to_string()),
            Item::Trait(item) => Some(item.ident.to_string()),
            Item::Type(item) => Some(item.ident.to_string()),
            _ => None,
        };
        self.file.items.iter().filter_map(name).collect()
    }

    /// All paths into the crate that it names, from its root, re-exports among them.
    pub(crate) fn paths(&self) -> Vec<Vec<String>> {
        let mut paths = self.imported();
        paths.extend(self.re_exports().into_iter().map(|(_, path)| path));
        paths
    }

    /// The paths that it uses itself: what it imports for its own, and what it names in code.
    fn imported(&self) -> Vec<Vec<String>> {
        let mut found = Paths { own: self.names(), paths: Vec::new() };
        found.visit_file(&self.file);
        found.paths
    }

    /// What it imports under which name, for its own use.
    fn renamed(&self) -> Vec<(String, Vec<String>)> {
        self.uses(|visibility| matches!(visibility, Visibility::Inherited))
    }

    /// What it hands on, under which name.
    fn re_exports(&self) -> Vec<(String, Vec<String>)> {
        self.uses(|visibility| !matches!(visibility, Visibility::Inherited))
    }

    fn uses(&self, wanted: impl Fn(&Visibility) -> bool) -> Vec<(String, Vec<String>)> {
        let mut found = Vec::new();
        for item in &self.file.items {
            if let Item::Use(item) = item
                && wanted(&item.vis)
            {
                for (name, path) in leaves(&item.tree) {
                    found.extend(absolute(&self.names(), &path).map(|path| (name, path)));
                }
            }
        }
        found
    }
}

fn is_test_module(item: &Item) -> bool {
    let is_test = |attribute: &Attribute| {
        attribute.path().is_ident("cfg")
            && attribute.to_token_stream().to_string().contains("(test)")
    };
    matches!(item, Item::Mod(module) if module.attrs.iter().any(is_test))
}

fn first_line(item: &Item) -> usize {
    use syn::spanned::Spanned;
    item.span().start().line
}

fn words_of(tokens: TokenStream) -> Vec<String> {
    let mut words = Vec::new();
    for token in tokens {
        match token {
            TokenTree::Group(group) => words.extend(words_of(group.stream())),
            TokenTree::Ident(word) => words.push(word.to_string()),
            TokenTree::Punct(sign) => words.push(sign.as_char().to_string()),
            TokenTree::Literal(_) => {}
        }
    }
    words
}

/// The paths of a `use`, each with the name that it gets.
fn leaves(tree: &UseTree) -> Vec<(String, Vec<String>)> {
    match tree {
        UseTree::Path(path) => {
            let head = path.ident.to_string();
            let rest = leaves(&path.tree).into_iter();
            rest.map(|(name, rest)| {
                // `use a::{self}` is `use a`.
                let name = if name == "self" { head.clone() } else { name };
                let rest = rest.into_iter().filter(|part| part != "self");
                (name, [head.clone()].into_iter().chain(rest).collect())
            })
            .collect()
        }
        UseTree::Name(name) => vec![(name.ident.to_string(), vec![name.ident.to_string()])],
        UseTree::Rename(name) => vec![(name.rename.to_string(), vec![name.ident.to_string()])],
        UseTree::Glob(_) => vec![("*".to_owned(), vec!["*".to_owned()])],
        UseTree::Group(group) => group.items.iter().flat_map(leaves).collect(),
    }
}

/// A path from the crate's root; `None` if it may lead elsewhere. `own` is the module it is read in.
fn absolute(own: &[String], path: &[String]) -> Option<Vec<String>> {
    let (first, mut rest) = path.split_first()?;
    let mut from = match &**first {
        "crate" => Vec::new(),
        "self" => own.to_vec(),
        "super" => own[..own.len().checked_sub(1)?].to_vec(),
        // A child or another crate: told apart when it is looked up.
        _ => return Some([own, path].concat()),
    };
    while let Some((part, after)) = rest.split_first()
        && part == "super"
    {
        from.pop()?;
        rest = after;
    }
    Some([&from[..], rest].concat())
}

/// Collects the paths that a file names.
struct Paths {
    own: Vec<String>,
    paths: Vec<Vec<String>>,
}

impl Paths {
    /// Paths that say themselves that they are of this crate.
    fn add(&mut self, path: &[String]) {
        if matches!(path.first().map(String::as_str), Some("crate" | "super" | "self")) {
            self.paths.extend(absolute(&self.own, path));
        }
    }
}

impl<'ast> Visit<'ast> for Paths {
    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        if matches!(item.vis, Visibility::Inherited) {
            for (_, path) in leaves(&item.tree) {
                self.paths.extend(absolute(&self.own, &path));
            }
        }
    }

    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        self.own.push(module.ident.to_string());
        visit::visit_item_mod(self, module);
        self.own.pop();
    }

    /// `pub(super)` imports nothing.
    fn visit_vis_restricted(&mut self, _: &'ast syn::VisRestricted) {}

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names: Vec<String> = path.segments.iter().map(|part| part.ident.to_string()).collect();
        self.add(&names);
        visit::visit_path(self, path);
    }

    /// What a macro is given may be anything: paths are told by how they begin.
    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        let words = words_of(call.tokens.clone());
        for at in 0..words.len() {
            let begins = at == 0 || words[at - 1] != ":";
            if begins && matches!(&*words[at], "crate" | "super" | "self") {
                let mut path = vec![words[at].clone()];
                let mut rest = &words[at + 1..];
                while let [a, b, name, after @ ..] = rest
                    && [a, b] == [":", ":"]
                {
                    path.push(name.clone());
                    rest = after;
                }
                if path.len() > 1 {
                    self.add(&path);
                }
            }
        }
        visit::visit_macro(self, call);
    }
}

/// All files of the library, to find out where a name comes from.
pub(crate) struct Crate<'a> {
    modules: BTreeMap<Vec<String>, &'a Source>,
}

impl<'a> Crate<'a> {
    pub(crate) fn of(sources: &'a [Source]) -> Self {
        let of_library = sources.iter().filter(|source| source.path.starts_with("src/"));
        Self { modules: of_library.map(|source| (source.names(), source)).collect() }
    }

    /// For every file the files that it imports from.
    pub(crate) fn imports(&self) -> BTreeMap<String, BTreeSet<String>> {
        let of = |source: &&Source| {
            let targets = source.imported().into_iter().flat_map(|path| self.files(&path, 0));
            targets.filter(|target| *target != source.path).collect()
        };
        self.modules.values().map(|source| (source.path.clone(), of(source))).collect()
    }

    /// The file that declares what a path names; several for everything of a module.
    fn files(&self, path: &[String], followed: usize) -> Vec<String> {
        assert!(followed < 20, "re-exports lead in a circle: {path:?}");
        // The longest beginning that is a module.
        let found = (0..=path.len())
            .rev()
            .find_map(|length| Some((self.modules.get(&path[..length])?, &path[length..])));
        let Some((source, rest)) = found else { return Vec::new() };
        let Some(name) = rest.first() else { return vec![source.path.clone()] };
        let handed_on = source.re_exports();
        if name == "*" {
            let all = handed_on.into_iter().flat_map(|(_, path)| self.files(&path, followed + 1));
            return all.chain([source.path.clone()]).collect();
        }
        if let Some((_, path)) = handed_on.iter().find(|(handed, _)| handed == name) {
            return self.files(path, followed + 1);
        }
        // A private import that children see by `super`.
        if let Some((_, path)) = source.renamed().iter().find(|(handed, _)| handed == name) {
            return self.files(path, followed + 1);
        }
        let declares = source.declares(name);
        declares.then(|| source.path.clone()).into_iter().collect()
    }
}

impl Source {
    fn declares(&self, name: &str) -> bool {
        self.file.items.iter().any(|item| match item {
            Item::Fn(item) => item.sig.ident == name,
            Item::Const(item) => item.ident == name,
            Item::Static(item) => item.ident == name,
            Item::Struct(item) => item.ident == name,
            Item::Enum(item) => item.ident == name,
            Item::Trait(item) => item.ident == name,
            Item::Type(item) => item.ident == name,
            Item::Mod(item) => item.ident == name && item.content.is_some(),
            Item::Macro(item) => item.ident.as_ref().is_some_and(|ident| ident == name),
            _ => false,
        })
    }
}

/// All Rust files below some folders of the repository.
pub(crate) fn sources(folders: &[&str]) -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut pending: Vec<PathBuf> = folders.iter().map(|folder| root.join(folder)).collect();
    let mut sources = Vec::new();
    while let Some(folder) = pending.pop() {
        for entry in std::fs::read_dir(&folder).expect("the folder is there") {
            let path = entry.expect("it can be listed").path();
            if path.is_dir() {
                pending.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let below = path.strip_prefix(root).expect("it lies below the root");
                let text = std::fs::read_to_string(&path).expect("source is UTF-8");
                sources.push(Source::new(&below.to_string_lossy().replace('\\', "/"), &text));
            }
        }
    }
    sources.sort_by(|a, b| a.path.cmp(&b.path));
    sources
}
