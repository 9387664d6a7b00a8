# SPDX-License-Identifier: Apache-2.0
"""Pages link to files of the tree outside docs/: the site has them under files/, pages as pages and others as they are."""
import pathlib
import posixpath
import re

from mkdocs.structure.files import File

ROOT = pathlib.Path(__file__).parents[2]
# Code is left as it is: brackets mean something else there. A link's text may be code.
CODE = r"^```.*?^```$|`(?!\]\()[^`\n]*`(?!\]\()"
LINK = re.compile(CODE + r"|(\]\()([^)\s#:]+)((?:#[^)\s]*)?\))", re.M | re.S)


def target_of(page, link):
    """The path in the tree of what a page, named by its own, links to."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(page), link))


def path_in_tree(file):
    return file.src_uri.removeprefix("files/") if file.src_uri.startswith("files/") else f"docs/{file.src_uri}"


def on_config(config):
    # Headings have the names that hosts of repositories give them.
    config.mdx_configs["toc"] = {"slugify": lambda text, _: re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-")}
    return config


def on_files(files, config):
    left = list(files.documentation_pages())
    while left:
        page = left.pop()
        for _, link, _ in LINK.findall(pathlib.Path(page.abs_src_path).read_text(encoding="utf-8")):
            if not link:
                continue
            target = target_of(path_in_tree(page), link)
            name = f"files/{target}"
            if target.startswith(("docs/", "../")) or files.get_file_from_path(name) or not (ROOT / target).is_file():
                continue
            files.append(File.generated(config, name, abs_src_path=str(ROOT / target)))
            if target.endswith(".md"):
                left.append(files.get_file_from_path(name))
    return files


def on_page_markdown(markdown, page, config, files):
    here = path_in_tree(page.file)

    def moved(match):
        if match[2] is None:
            return match[0]
        target = target_of(here, match[2])
        path = target.removeprefix("docs/") if target.startswith("docs/") else f"files/{target}"
        if (ROOT / target).is_dir():
            index = f"{path}/README.md"
            if files.get_file_from_path(index) is None:
                return "](" + posixpath.relpath("README.md", posixpath.dirname(page.file.src_uri) or ".") + ")"
            path = index
        return match[1] + posixpath.relpath(path, posixpath.dirname(page.file.src_uri) or ".") + match[3]

    return LINK.sub(moved, markdown)
