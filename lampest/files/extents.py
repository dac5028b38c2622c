"""Where in an HDF5 file its groups and datasets lie."""

import h5py

from lampest.files.seal import Extent


def extents_of(file: h5py.File) -> list[Extent]:
    """The values of every dataset, and where the header of every object begins; of a file that was flushed."""
    found = [Extent("/", h5py.h5o.get_info(file.id).addr)]

    def visit(name: bytes, info: h5py.h5o.ObjInfo) -> None:
        path = f"/{name.decode('utf-8', 'replace')}"
        found.append(Extent(path, info.addr))
        if info.type == h5py.h5o.TYPE_DATASET:
            found.extend(_values(h5py.h5d.open(file.id, name), path))

    h5py.h5o.visit(file.id, visit, info=True)
    return found


def _values(dataset: h5py.h5d.DatasetID, path: str) -> list[Extent]:
    if dataset.get_create_plist().get_layout() == h5py.h5d.CHUNKED:
        chunks: list[Extent] = []

        def visit(chunk: h5py.h5d.StoreInfo) -> None:
            chunks.append(Extent(path, chunk.byte_offset, chunk.size))

        dataset.chunk_iter(visit)
        return chunks
    begin = dataset.get_offset()  # None: nothing stored, or in the header
    return [] if begin is None else [Extent(path, begin, dataset.get_storage_size())]
